"""World models under evaluation: adapters behind one protocol."""
