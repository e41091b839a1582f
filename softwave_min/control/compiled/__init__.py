"""The compiled twin of solver and plant, and the generator of its C code."""
