"""Many scenes: a table of scenes, styles, methods and seeds as Snakemake jobs of one verb each."""
