"""A planar soft arm in waves: the model, the controllers and the experiments."""
