"""The demo's robot: ordinary rclpy nodes, their planner, and the run that compares with and without arpd."""
