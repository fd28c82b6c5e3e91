"""What spinning ends with."""


class ExternalShutdownException(Exception):
    pass
