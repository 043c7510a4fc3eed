"""What the package's own warnings have in common."""


class SoftcalWarning(UserWarning):
    """Any warning of this package: the commands show each as a line of its own."""
