"""The expert study: a blinded kit of images, ratings of it, and how they agree."""
