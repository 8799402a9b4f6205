"""From a camera's files to one static image: decoding, privacy areas, weights of the captures, and their median."""
