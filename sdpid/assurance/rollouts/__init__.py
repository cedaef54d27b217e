"""Judge an estimate by how its robot moves under the measured efforts."""
