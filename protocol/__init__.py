"""What is said: cells, packets, messages, keys and the bus that carries them."""
