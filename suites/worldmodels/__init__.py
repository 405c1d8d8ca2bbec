"""World models to be judged: each adapter a module of its own, all behind one protocol."""
