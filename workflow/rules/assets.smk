"""Assets: the chosen mesh as a body for robots and simulators, and its pictures with cameras for other tools.

results/DATASET/OBJECT/NVS.body/                          visual mesh, convex parts, mass and inertia: what the files below refer to
results/DATASET/OBJECT/NVS.{urdf,mjcf.xml,usda,usdz}      the body for each simulator
results/DATASET/OBJECT/NVS.{foundationpose,nerfstudio,colmap,bop}/
"""

MESH, TEXTURE_FILE, FACTS = (f"{OBJECT}/{{nvs}}.{end}" for end in ("ply", "png", "json"))
BODY = {"body": f"{OBJECT}/{{nvs}}.body"}
SCALE, PACKAGE, DATE = (step_options({name: settings["assets"][name]}) for name in ("unknown_scale", "package", "date"))
MADE = "Writing {output}"
BODY_MADE = "Making a rigid body of {wildcards.object}: mass, inertia and convex parts"
FOR_POSES = "Writing the mesh of {wildcards.object} as FoundationPose reads it"
FOR_BOP = "Writing photos, masks and poses of {wildcards.object} as a scene of BOP"
FOR_LAYOUT = "Writing photos, masks and cameras of {wildcards.object} for {wildcards.layout}"
IN_PHOTOS = {"mesh": plan.of_each_in_photos(MESH.format_map), "cameras": plan.of_each_in_photos(plan.chosen_cameras)}
PHOTOS_OF_MESH = {"mesh": MESH, "cameras": plan.chosen_cameras}
# By rule: the method, the ending, what it reads, by options, and beside that; its options, MB, minutes and what it says.
EXPORTS = {
    "body": ("body", "body", {"mesh": MESH}, [TEXTURE_FILE, FACTS], plan.mass_options, 2000, 10, BODY_MADE),
    "urdf": ("urdf", "urdf", BODY, [], PACKAGE, 500, 5, MADE),
    "mjcf": ("mjcf", "mjcf.xml", BODY, [], "", 500, 5, MADE),
    "usd": ("usd", "{usd}", BODY, [], DATE, 1000, 5, MADE),
    "foundationpose": ("foundationpose", "foundationpose", {"mesh": MESH}, [TEXTURE_FILE, FACTS], SCALE, 1000, 5, FOR_POSES),
    "bop_export": ("bop", "bop", IN_PHOTOS, [plan.of_each_in_photos(FACTS.format_map)], SCALE, 2000, 20, FOR_BOP),
    "photo_export": ("{layout}", "{layout}", PHOTOS_OF_MESH, [FACTS], SCALE, 1000, 5, FOR_LAYOUT),
}
FOLDERS = ("body", "foundationpose", "bop_export", "photo_export")


localrules:
    urdf,
    mjcf,


for name, (method, ending, reads, beside, options, mb, minutes, says) in EXPORTS.items():
    path = f"{OBJECT}/{{nvs}}.{ending}"

    rule:
        name:
            name
        input:
            beside,
            **reads,
        output:
            directory(path) if name in FOLDERS else path,
        log:
            f"{OBJECT}/logs/{ending.removesuffix('.xml')}.{{nvs}}.log",
        wildcard_constraints:
            usd="usda|usdz",
            layout="nerfstudio|colmap",
        resources:
            **needs(mb, minutes),
        params:
            method=method,
            inputs=given(*reads),
            options=options,
        message:
            says
        shell:
            "python -m zeroshop_steps.assets --method {params.method} {params.inputs} {params.options} --out {output} > {log} 2>&1"
