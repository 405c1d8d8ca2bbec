"""Procedural assets and looks: meshes, textures and physics generated from seeds, without downloads."""
