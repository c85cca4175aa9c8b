"""The articulated least-squares step, one frame or a whole clip."""
