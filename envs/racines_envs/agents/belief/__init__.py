"""PPO on what a servo's readings add up to: one policy for all views, with a memory."""
