"""Human motion from ordinary cameras: a weighted set of pose hypotheses, held to the evidence in the images."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hypose")
except PackageNotFoundError:  # run from a checkout that was never installed
    __version__ = "0+unknown"
