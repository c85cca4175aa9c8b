"""Camera calibration: from boards, measured points or a person; diagnostics of a calibration; refinement with the
person.
"""
