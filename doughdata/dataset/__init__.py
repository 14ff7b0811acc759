"""The dataset on disk: writer, reader, derived tables, validation."""
