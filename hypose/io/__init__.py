"""Reading and writing of files: recordings, videos, calibrations, results.

Other units and axes are converted here, so that the rest of hypose has SI units and a world with z up.
"""
