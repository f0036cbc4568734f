"""Models of the API's documents, from which their JSON Schemas are made."""
