"""The demonstration on Docker Compose, and what follows its containers and logs."""
