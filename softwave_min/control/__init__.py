"""The controllers, and what they are told of the sea."""
