"""What a trial tolerates, as a page and a figure: `material` is what they are made from."""
