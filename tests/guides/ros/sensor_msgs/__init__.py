"""Laser scans."""
