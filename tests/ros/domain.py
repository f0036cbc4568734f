"""The ROS domain of this process: pytest's workers run side by side and must not hear each other."""

import os

DOMAIN = 1 + os.getpid() % 45  # tests/chaos takes those above 50
