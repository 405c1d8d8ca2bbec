"""Registration of the CAD model to one frame: correspondences, least squares, silhouette, arm, ICP."""
