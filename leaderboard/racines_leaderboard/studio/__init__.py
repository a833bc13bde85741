"""RACINES Studio: the boards, the study and the data in a browser (`racines studio`)."""
