"""Many animals: walls fitted one by one, and what they say together."""
