"""Files in, files out: recordings, videos, calibrations, results. Units other than SI and other axes end
here."""
