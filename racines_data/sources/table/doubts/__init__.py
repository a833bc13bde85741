"""What looks wrong with a mapping, in words: by the columns' names, by their numbers, by motion.

`base` has what a doubt is; `names` holds the names of columns against what the mapping takes them
for; `values` looks at single numbers; `motion` at what rotations and positions say together; `find`
runs them. What is certain is refused; what is inferred can be allowed (`--allow reading`).
"""
