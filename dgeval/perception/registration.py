"""Registration of P_t to the model cloud Q_{t-1}, and the gate (docs/papers.md, "ICP gate", "ICP
direction and fitness").

Three libraries have the same interface. Each gets the same clouds, search radius and starting pose;
benchmarks/registration.py decides which one is the default.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from small_gicp import KdTree

from dgeval.config import RegistrationConfig
from dgeval.errors import MissingDependencyError
from dgeval.geometry import Array, Intrinsics, depth_sigma, invert, rotation_angle, transform
from dgeval.perception import align
from dgeval.perception.depth_noise import DepthNoise
from dgeval.perception.neighbours import nearest
from dgeval.perception.types import Features, Model, Observation, Registration

SPACED = 300  # points of a model whose spacing is measured
# times its median, within which nearly all points of a random surface have a neighbour
APART = 2.5
# px, within which a feature is where the pose has it; number of them that can speak against the
# result of ICP, and share of those at the start that must be there still; ours
FEATURE_PX, LEAST_FEATURES, AS_MANY = 3.0, 12, 0.5
# (source (n, 3) m, target, T_model_camera to start from, configuration) -> T_model_camera
Backend = Callable[[Array, Model, Array, RegistrationConfig], Array]


def align_small_gicp(
    source: Array, target: Model, T_init: Array, config: RegistrationConfig
) -> Array:
    """T_model_camera by the point-to-plane ICP of small_gicp, one thread.

    Its clouds don't take given normals, so normals are estimated here, on every second point of a
    full model. Both clouds are thinned to save time; benchmarks/registration.py measures no loss of
    accuracy.
    """
    import small_gicp

    cloud = small_gicp.PointCloud(target.points[:: max(1, len(target.points) // 2000)])
    tree = small_gicp.KdTree(cloud, num_threads=1)
    small_gicp.estimate_normals(cloud, tree, num_neighbors=10, num_threads=1)
    result = small_gicp.align(
        cloud,
        small_gicp.PointCloud(source[:: max(1, len(source) // 500)]),
        tree,
        init_T_target_source=T_init,
        registration_type="PLANE_ICP",
        max_correspondence_distance=config.search_radius,
        num_threads=1,
        max_iterations=config.max_iterations,
        rotation_epsilon=1e-3,
        translation_epsilon=1e-4,
    )
    return np.asarray(result.T_target_source)


def align_open3d(source: Array, target: Model, T_init: Array, config: RegistrationConfig) -> Array:
    """T_model_camera by the point-to-plane ICP of Open3D's legacy pipeline, one thread."""
    o3d = import_open3d()
    clouds = []
    for points in (source, target.points):
        cloud = o3d.geometry.PointCloud()
        cloud.points = o3d.utility.Vector3dVector(points)
        clouds.append(cloud)
    clouds[1].normals = o3d.utility.Vector3dVector(target.normals)
    registration = o3d.pipelines.registration
    result = registration.registration_icp(
        clouds[0],
        clouds[1],
        config.search_radius,
        T_init,
        registration.TransformationEstimationPointToPlane(),
        registration.ICPConvergenceCriteria(1e-6, 1e-6, config.max_iterations),
    )
    return np.asarray(result.transformation)


def align_kiss_icp(
    source: Array, target: Model, T_init: Array, config: RegistrationConfig
) -> Array:
    """T_model_camera by KISS-ICP's point-to-point registration to a 5 mm voxel map, one thread.

    Its configuration class reads the environment, so the parts are built directly. They are made
    for LiDAR; here their sizes are scaled to a hand-sized object.
    """
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.registration import Registration as KissRegistration

    voxels = VoxelHashMap(voxel_size=0.005, max_distance=10.0, max_points_per_voxel=20)
    voxels.add_points(target.points)
    registration = KissRegistration(
        max_num_iterations=50, convergence_criterion=1e-5, max_num_threads=1
    )
    return np.asarray(
        registration.align_points_to_map(
            source, voxels, T_init, config.search_radius, config.search_radius / 3
        )
    )


BACKENDS: dict[str, Backend] = {
    "small_gicp": align_small_gicp,
    "open3d": align_open3d,
    "kiss_icp": align_kiss_icp,
}


def import_open3d() -> Any:
    """The module open3d, set to one thread. MissingDependencyError names what is missing."""
    import ctypes

    try:
        import libusb_package

        # Open3D's wheel needs libusb-1.0, which minimal systems lack; the package contains one that
        # needs no root
        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # a system may have its own libusb; without any the import below fails
    try:
        import open3d as o3d
    except (ImportError, OSError) as error:
        hint = (
            "apt-get install libusb-1.0-0 libgl1 libegl1 libx11-6, or use "
            "--set registration.method=small_gicp"
        )
        raise MissingDependencyError(f"Open3D can't be imported ({error})", hint=hint) from error
    # Open3D's threads are TBB's, which OMP_NUM_THREADS does not limit
    o3d.utility.set_max_threads(1)
    return o3d


def register(
    observation: Observation,
    model: Model,
    T_camera_model: Array,
    features: Features | None,
    camera: Intrinsics,
    config: RegistrationConfig,
    noise: DepthNoise | None = None,
) -> Registration:
    """Register P_t to Q_{t-1} from a starting pose, refine with image features, measure the fit.

    The gate is not applied. noise: see `fit`.
    """
    T = BACKENDS[config.method](observation.points, model, invert(T_camera_model), config)
    if not np.isfinite(T).all():
        return Registration(T_camera_model, 0.0, 0.0, None, "not_finite")
    T = invert(np.asarray(T, dtype=np.float64))
    if config.colour and features is not None:
        # a face that the model lacks pulls ICP round until it lies on the one beside it
        seen = _seen_features(T_camera_model, features, camera)
        if seen >= LEAST_FEATURES and _seen_features(T, features, camera) < AS_MANY * seen:
            T = T_camera_model
    tree = KdTree(model.points, num_threads=1)
    T = _refine(T, observation, model, tree, features if config.colour else None, camera, config)
    return _fit(T, observation, model, tree, config, noise, ())


def _seen_features(T_camera_model: Array, features: Features, camera: Intrinsics) -> int:
    """How many of the features appear where the model at this pose has them."""
    points = transform(T_camera_model, features.points)
    ahead = points[:, 2] > 0.05
    apart = np.linalg.norm(camera.project(points[ahead]) - features.pixels[ahead], axis=1)
    return int(np.count_nonzero(apart < FEATURE_PX))


def fit(
    observation: Observation,
    model: Model,
    T: Array,
    config: RegistrationConfig,
    noise: DepthNoise | None = None,
    also: Sequence[Model] = (),
) -> Registration:
    """How well P_t fits Q_{t-1} at T_camera_model (4, 4), which is left as it is.

    Fitness: share of P_t with a model point within the search radius. Gate fitness: share with one
    within max(gate_distance, 2 sigma(z)) m along its normal, and no farther beside it than the
    model's points are apart. noise: of this recording's depth, else the sensor model's. rmse: m,
    over the points that count for the fitness. also: clouds, model frame; what each of them matches
    counts for the gate fitness as well.
    """
    return _fit(T, observation, model, KdTree(model.points, num_threads=1), config, noise, also)


def _fit(
    T: Array,
    observation: Observation,
    model: Model,
    tree: KdTree,
    config: RegistrationConfig,
    noise: DepthNoise | None,
    also: Sequence[Model],
) -> Registration:
    points = transform(invert(T), observation.points)
    limit = np.maximum(
        config.gate_distance, 2 * (noise or DepthNoise()).sigma(observation.points[:, 2])
    )
    distance, close = _matches(points, model, tree, limit, config)
    if also:
        each = [
            _matches(points, cloud, KdTree(cloud.points, num_threads=1), limit, config)[1]
            for cloud in also
        ]
        close |= np.all(each, axis=0)
    matched = distance < config.search_radius
    rmse = float(np.sqrt(np.mean(distance[matched] ** 2))) if matched.any() else None
    return Registration(T, float(matched.mean()), float(close.mean()), rmse, None)


def _matches(
    points: Array, model: Model, tree: KdTree, limit: Array, config: RegistrationConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Distances (n,) m of points (n, 3), model frame, to a model, and which of them match it.

    limit (n,): m, along the model's normal.
    """
    index, distance = nearest(tree, points)
    along = np.abs(np.einsum("ij,ij->i", points - model.points[index], model.normals[index]))
    beside = np.sqrt(np.maximum(distance**2 - along**2, 0.0))
    most = max(config.gate_distance, APART * spacing(model, tree))
    return distance, (along < limit) & (beside < most)


def spacing(model: Model, tree: KdTree) -> float:
    """m, how far the points of a model are apart: the median to the nearest other one."""
    some = model.points[:: max(1, len(model.points) // SPACED)]
    _, squared = tree.batch_knn_search(some, 2, num_threads=1)
    return float(np.sqrt(np.median(np.asarray(squared)[:, 1])))


def _refine(
    T: Array,
    observation: Observation,
    model: Model,
    tree: KdTree,
    features: Features | None,
    camera: Intrinsics,
    config: RegistrationConfig,
) -> Array:
    """T_camera_model refined point to plane with the model's normals, and by the features.

    Features fix the directions that the geometry leaves free. The model's normals were measured in
    the depth image; normals that a library estimates from the merged points are noisier and cost
    degrees on a small box at 1 m (benchmarks/registration.py). Both terms are weighted by their
    noise.
    """
    sigma = depth_sigma(observation.points[:, 2])
    for cutoff_m, cutoff_px in ((0.010, 3.0), (0.006, 2.0)):
        index, distance = nearest(tree, transform(invert(T), observation.points))
        matched = distance < config.search_radius
        q = transform(T, model.points[index[matched]])
        n = model.normals[index[matched]] @ T[:3, :3].T
        H, g, used = align.depth_normal_equations(
            q, observation.points[matched], n, sigma[matched], cutoff_m
        )
        used_features = 0
        if features is not None and len(features.points) >= 6:
            Hf, gf, used_features = align.feature_normal_equations(
                transform(T, features.points), features.pixels, camera, cutoff_px
            )
            H, g = H + Hf, g + gf
        if used < 20 and used_features < 8:
            return T
        T = align.solve(H, g) @ T
    return T


def gate(
    registration: Registration,
    T_camera_model_accepted: Array,
    centroid: Array,
    seconds: float,
    config: RegistrationConfig,
) -> str | None:
    """Why a registration is rejected, or None if it is accepted.

    Paper III-A.2: the fitness must exceed c_a,f, the motion must not exceed c_a,v and c_a,omega.
    Motion is that of the model's centroid (3,) m, model frame, and of its axes, relative to the
    camera, since the last accepted frame, `seconds` ago (docs/papers.md, "ICP gate").
    """
    if registration.reject_reason is not None:
        return registration.reject_reason
    if registration.gate_fitness <= config.c_a_f:
        return "fitness"
    T = registration.T_camera_model
    moved = transform(T, centroid[None])[0] - transform(T_camera_model_accepted, centroid[None])[0]
    if float(np.linalg.norm(moved)) > config.c_a_v * seconds:
        return "translation"
    if rotation_angle(T[:3, :3] @ T_camera_model_accepted[:3, :3].T) > config.c_a_w * seconds:
        return "rotation"
    return None
