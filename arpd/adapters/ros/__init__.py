"""The ROS 2 side: adaptive publishers, relay, peer, graph and parameters."""
