"""Introspection online: beliefs about the sub-task and its health while the robot works."""
