"""What a recording of a robot with a floating base has beside its joints."""
