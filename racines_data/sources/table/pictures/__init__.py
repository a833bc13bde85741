"""Images of a sweep, whatever holds them: files, a video, an array, a PLUS sequence, DICOM.

`base` has the protocol and its limits, `opening` finds the reader by the file's ending; each other
module is one reader. Headers are checked before anything is decoded, and frames come one at a time.
"""
