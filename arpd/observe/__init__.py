"""What arrives from the network: who may say how much, and what is believed of it."""
