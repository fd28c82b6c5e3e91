"""Messages of geometry; the stub makes them as plain objects."""


class PoseWithCovarianceStamped:
    pass
