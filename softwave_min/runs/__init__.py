"""Results: what determines them, who computes them, how they are kept and compared."""
