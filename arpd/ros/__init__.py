"""The ROS 2 side: AdaptivePublisher, relay, peer, and the daemon's view of the graph."""
