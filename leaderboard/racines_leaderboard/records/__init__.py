"""Records: one sealed JSON file a system and board; what they hold and how they are checked."""
