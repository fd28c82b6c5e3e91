"""Messages of navigation; the stub makes them as plain objects."""


class Odometry:
    pass
