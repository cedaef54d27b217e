"""Contacts: Jacobians of their points, enclosed, and what their errors do to a cost."""
