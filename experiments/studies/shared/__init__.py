"""What several studies share: frames, trackers and how they are judged."""
