"""Messages of sensors; the stub makes them as plain objects."""


class LaserScan:
    pass
