"""Pictures of cameras on the network: taken all at once, and saved under the names that a run looks for."""
