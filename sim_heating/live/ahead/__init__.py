"""What is ahead: the futures of a flight, and the temperatures on them."""
