"""The tabs of the Studio, a module each with `build(place)`."""
