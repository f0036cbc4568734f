"""The world behind the pure ring: ROS 2, the host, systemd, HTTP, the configuration file, and a simulated link."""
