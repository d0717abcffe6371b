"""The look of all figures and HTML pages."""
