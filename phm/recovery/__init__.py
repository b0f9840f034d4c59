"""Recovery: the policy decides (pure), the executor acts and proves, actions are plug-ins."""
