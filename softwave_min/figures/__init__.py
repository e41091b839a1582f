"""The figures of the paper, one module per experiment, in one style."""
