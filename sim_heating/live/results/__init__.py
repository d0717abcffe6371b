"""Results of a link that has ended: what it followed, its report, its files."""
