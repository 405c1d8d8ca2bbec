"""Clips with one planted fault of the kinds that world models make, and the truth as drawn."""
