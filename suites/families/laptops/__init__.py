"""Laptops with a hinged screen."""
