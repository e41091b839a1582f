"""The experiments: one module each, with its runs and the tables made of them."""
