"""Procedural things to handle and places to do it in: shapes, surfaces, physics, all from seeds, nothing downloaded."""
