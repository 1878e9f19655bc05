"""Reference results: the truth in the parameters of the catalogue, fits with the true causes, visibility."""
