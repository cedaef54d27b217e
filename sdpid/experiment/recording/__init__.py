"""The recording: time stamps, joints, units, storage."""
