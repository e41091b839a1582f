"""The paper: its cases and numbers, its claims with their verdicts, and what it leaves open."""
