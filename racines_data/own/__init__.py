"""Phantoms of one's own: surfaces or a label map, with a YAML of tissues, landmarks and views.

sheet              what tissues.yaml says, checked
meshes, nifti      what is read: surfaces of all phases, closed; a label map and its affine
voxels             parts painted on a grid
marks              landmarks, views and place, in the organ's frame
warp               how a heart moves: from where its tissue is now to where it was
make               all of it, into a folder that `racines_data.phantom.saved` reads
heart, pool        such a heart among the patients: in their chests, beating
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
