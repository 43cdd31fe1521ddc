"""Many scenes: a table of scenes, styles, methods and seeds as jobs of Snakemake, each of them one verb."""
