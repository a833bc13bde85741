"""A supervised agent for any patient: it reads from the image where the views are, and goes there.

`frames` draws what it learns from, `visits` what it sees on its own ways; `learner` trains the
network, `rounds` orders the trainings. `belief` fuses what it reads over the steps of an episode,
`search` feels out where the view is best, `mind` is what it keeps, `agent` acts.
"""
