"""The ROS domain of the tests; `tests.network` sees to it that no other process is in it."""

DOMAIN = 1
