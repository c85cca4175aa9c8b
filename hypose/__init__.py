"""Human motion from ordinary cameras: weighted hypotheses of pose, held to the evidence in the images."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hypose")
except PackageNotFoundError:  # run from a checkout that was never installed
    __version__ = "0+unknown"
