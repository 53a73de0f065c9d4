"""From pictures to keypoints: frames of videos, detectors, people followed over time."""
