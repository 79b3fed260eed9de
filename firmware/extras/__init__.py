"""What only some boards have. A board loads what its file asks for, and nothing else."""
