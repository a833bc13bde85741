"""A supervised agent for any patient: it reads from the image where the views are, and goes there.

`frames` draws what it learns from, `learner` trains the network, `belief` fuses what it reads over
the steps of an episode, `agent` acts.
"""
