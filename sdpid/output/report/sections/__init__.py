"""The report's sections: what each shows, as values of its template."""
