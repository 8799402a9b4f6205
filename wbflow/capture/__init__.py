"""From the cameras of a site to tonight's captures."""
