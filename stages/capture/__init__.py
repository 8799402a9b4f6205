"""From the files that a camera delivers to one static picture: decoding, what nobody may see, which frames count, the median."""
