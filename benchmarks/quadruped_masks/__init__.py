"""Animals with missing joints: what masks add to keypoints."""
