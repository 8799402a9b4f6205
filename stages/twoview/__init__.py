"""The geometry of two views: F and E, estimated, refined, judged."""
