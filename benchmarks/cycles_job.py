"""Renders a mesh with Blender's Cycles; run by a Python that has `bpy`. Reads a request from stdin, answers on stdout, as JSON.

Request: `folder` with meshes.npz (vertices and faces by name, marker frame, metres), `albedos` by name, camera
(`matrix` camera to world by Blender's axes, `fov_rad`, `width`, `height`, `filter_px`), `leds` positions or `sun`
direction and angular diameter, `samples`, `seeds`, `threads`. Answer: seconds of each frame; frames are kept as
frames.npy in the folder, (seeds, height, width).
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path


def main() -> None:
    import bpy
    import numpy as np
    from mathutils import Matrix, Vector

    request = json.loads(sys.stdin.read())
    folder = Path(request["folder"])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene

    meshes = np.load(folder / "meshes.npz")
    for name, albedo in request["albedos"].items():
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata(meshes[f"{name}_vertices"].tolist(), [], meshes[f"{name}_faces"].tolist())
        mesh.update()
        material = bpy.data.materials.new(name)
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
        diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1)
        material.node_tree.links.new(diffuse.outputs["BSDF"], output.inputs["Surface"])
        mesh.materials.append(material)
        scene.collection.objects.link(bpy.data.objects.new(name, mesh))

    if "sun" in request:
        light = bpy.data.lights.new("sun", "SUN")
        light.energy, light.angle = 1.0, request["sun_diameter_rad"]
        lamp = bpy.data.objects.new("sun", light)
        lamp.rotation_mode = "QUATERNION"
        lamp.rotation_quaternion = Vector(request["sun"]).to_track_quat("Z", "Y")
        scene.collection.objects.link(lamp)
    else:
        for k, place in enumerate(request["leds"]):
            light = bpy.data.lights.new(f"led{k}", "POINT")
            light.energy, light.shadow_soft_size = 4 * np.pi / len(request["leds"]), 0.0
            lamp = bpy.data.objects.new(f"led{k}", light)
            lamp.location = place
            scene.collection.objects.link(lamp)

    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.angle = "HORIZONTAL", request["fov_rad"]
    data.clip_start, data.clip_end = 0.01, 1000
    camera = bpy.data.objects.new("camera", data)
    camera.matrix_world = Matrix(request["matrix"])
    scene.collection.objects.link(camera)
    scene.camera = camera

    scene.world = bpy.data.worlds.new("space")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y, render.resolution_percentage = request["width"], request["height"], 100
    render.threads_mode, render.threads = "FIXED", request["threads"]
    render.use_persistent_data = True
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.exr_codec, render.image_settings.color_mode = "NONE", "RGB"
    scene.view_settings.view_transform = "Raw"
    cycles.device, cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = (
        "CPU",
        request["samples"],
        False,
        False,
    )
    cycles.max_bounces = cycles.diffuse_bounces = 0
    cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", request["filter_px"]

    frames, times = [], []
    for seed in range(request["seeds"] + 1):  # the first builds the scene
        cycles.seed = seed
        render.filepath = str(folder / "frame.exr")
        start = time.perf_counter()
        bpy.ops.render.render(write_still=True)
        times.append(time.perf_counter() - start)
        image = bpy.data.images.load(render.filepath)
        pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        frames.append(
            pixels.reshape(image.size[1], image.size[0], image.channels)[::-1, :, 0]
        )  # rows upwards in Blender
        bpy.data.images.remove(image)
    np.save(folder / "frames.npy", np.array(frames[1:]))
    print("\n" + json.dumps({"seconds": times[1:], "version": bpy.app.version_string}))


if __name__ == "__main__":
    main()
