"""What is wrong with a recording, as data: one function a check, one `Finding` a defect."""
