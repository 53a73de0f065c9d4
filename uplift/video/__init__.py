"""Videos, pictures and cameras in: their frames, one at a time, and the keypoints of everyone in them."""
