"""What is on disk: artifact kinds, manifests, codecs, migrations and the store."""
