"""Everything on disk: artifact kinds, manifests, file formats, migrations and the work folder."""
