"""The ROS domain of this process: pytest's workers run in parallel and must not hear each other."""

import os

DOMAIN = 1 + os.getpid() % 45  # tests/chaos uses those above 50
