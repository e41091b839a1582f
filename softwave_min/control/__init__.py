"""The optimal control problem and what solves it, the baseline, and the preview of the sea."""
