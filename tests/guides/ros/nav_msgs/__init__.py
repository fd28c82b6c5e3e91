"""Odometry."""
