"""ZeroShOP: pictures of an object become a textured mesh of true size and known frame.

The workflow itself is workflow/Snakefile, where Snakemake's catalogue expects it; this one lies where people look first. Both give
the same plan, from any folder. Snakemake looks for profiles beside the Snakefile that it reads, hence the link `profiles`.
"""


include: "workflow/Snakefile"


# The default target of an included file does not count.
workflow.default_target = "all"
