"""Things found in recordings: boards by their corners, a lamp by its light, and a picture a camera that shows what was found."""
