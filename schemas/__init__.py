"""What is on disk: artefact kinds, manifests, codecs, migrations and the store."""
