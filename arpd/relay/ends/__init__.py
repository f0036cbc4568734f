"""A relay with two ends: both run this code, in their own ROS domain and in the domain of the link."""
