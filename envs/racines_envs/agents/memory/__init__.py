"""A servo with a memory: it looks back over all images of an episode before it rests.

It searches as the servo does (`agent`, which notes in `notes` what it sees through `eyes`). Then it
goes to where all images together say that the view is, looks about there, and rests at the best of
all poses passed (`lead`). `episodes` are what it learns from, `learner` trains the network, and
`rounds` orders the trainings.
"""
