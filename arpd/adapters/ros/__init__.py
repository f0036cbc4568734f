"""The ROS 2 side: AdaptivePublisher, AdaptiveSubscription, relay, peer, and the daemon's view of the graph."""
