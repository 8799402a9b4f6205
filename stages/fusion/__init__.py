"""The steps of fusion, in the order in which `fuse` takes them."""
