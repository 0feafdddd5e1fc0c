"""What the rules ask when Snakemake plans: datasets, captures, methods and their options, cells, and what tables are made of.

`pages.Pages` has it all; the rules (workflow/rules) name files and commands. Nothing here runs a step.
"""
