"""What is known of a record before any reading: by its declared table, and of the error of its model."""
