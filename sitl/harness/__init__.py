"""What the demonstration, the benches, the acceptance run and the campaign share: agents in Compose, and PHM's log."""
