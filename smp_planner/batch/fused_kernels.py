"""The costs of a batch and the check of trajectories as fused kernels in Triton.

Triton comes with torch on Linux with CUDA; this module can be imported only where it is installed.
The arithmetic is that of `smp_planner.batch.plain_costs`, which says in plain torch what is
computed. A program takes `BLOCK` configurations, neighbours on their trajectory, through the chain.
All that is the same for them (links and obstacles that are far, spheres, shapes) is decided once.

What bounds a block is measured from balls around links: the distance of a sphere on link k to an
obstacle is at least that of the ball's centre less the ball's radius (all radii included), and
likewise for two spheres and the balls of their links.
"""

# Kernels carry no annotations but `tl.constexpr`: Triton infers the types.
# mypy: disable-error-code="no-untyped-def, assignment, var-annotated"
# Tuples are built by concatenation: that is what Triton compiles.
# ruff: noqa: RUF005

from __future__ import annotations

import triton
import triton.language as tl

__all__ = ["collisions", "gaps", "tools"]

_FAR = tl.constexpr(1e9)
_ABSENT = tl.constexpr(-1e3)
_LEAST = tl.constexpr(1e-20)


@triton.jit
def _turn(chain, joint, before, sine, cosine):
    """Return the pose of the link after a joint: nine numbers of rotation, three of position."""
    row = chain + 12 * (joint + 1)
    o0 = tl.load(row)
    o1 = tl.load(row + 1)
    o2 = tl.load(row + 2)
    o3 = tl.load(row + 3)
    o4 = tl.load(row + 4)
    o5 = tl.load(row + 5)
    o6 = tl.load(row + 6)
    o7 = tl.load(row + 7)
    o8 = tl.load(row + 8)
    o9 = tl.load(row + 9)
    o10 = tl.load(row + 10)
    o11 = tl.load(row + 11)
    turned = ()
    placed = ()
    for i in tl.static_range(3):
        a = before[3 * i]
        b = before[3 * i + 1]
        c = before[3 * i + 2]
        x = a * o0 + b * o3 + c * o6
        y = a * o1 + b * o4 + c * o7
        turned = turned + (
            x * cosine + y * sine,
            y * cosine - x * sine,
            a * o2 + b * o5 + c * o8 + 0.0 * sine,
        )
        placed = placed + (before[9 + i] + (a * o9 + b * o10 + c * o11) + 0.0 * sine,)
    return turned + placed


@triton.jit
def _base(chain, BLOCK: tl.constexpr):
    """Return the pose of link 0."""
    pose = ()
    for i in tl.static_range(12):
        pose = pose + (tl.zeros([BLOCK], tl.float32) + tl.load(chain + i),)
    return pose


@triton.jit
def _slide(chain, joint, before, length):
    """Return the pose of the link after a prismatic joint: `_turn` by 0, moved along its axis."""
    after = _turn(chain, joint, before, 0.0 * length, 0.0 * length + 1.0)
    turned = ()
    placed = ()
    for i in tl.static_range(9):
        turned = turned + (after[i],)
    for i in tl.static_range(3):
        placed = placed + (after[9 + i] + after[2 + 3 * i] * length,)
    return turned + placed


@triton.jit
def _poses(chain, angles, JOINTS: tl.constexpr, PRISMATIC: tl.constexpr, BLOCK: tl.constexpr):
    """Return the poses of all links, 12 numbers each, of a tuple of angles, or lengths."""
    poses = _base(chain, BLOCK)
    before = poses
    for joint in tl.static_range(JOINTS):
        if PRISMATIC[joint]:
            before = _slide(chain, joint, before, angles[joint])
        else:
            before = _turn(chain, joint, before, tl.sin(angles[joint]), tl.cos(angles[joint]))
        poses = poses + before
    return poses


@triton.jit
def _place(poses, link: tl.constexpr, x, y, z):
    """Return the place of a point of a link."""
    p: tl.constexpr = 12 * link
    return (
        poses[p + 9] + poses[p] * x + poses[p + 1] * y + poses[p + 2] * z,
        poses[p + 10] + poses[p + 3] * x + poses[p + 4] * y + poses[p + 5] * z,
        poses[p + 11] + poses[p + 6] * x + poses[p + 7] * y + poses[p + 8] * z,
    )


@triton.jit
def _rotated(poses, link: tl.constexpr, x, y, z):
    """Return a vector of the frame of a link in the base frame."""
    p: tl.constexpr = 12 * link
    return (
        poses[p] * x + poses[p + 1] * y + poses[p + 2] * z,
        poses[p + 3] * x + poses[p + 4] * y + poses[p + 5] * z,
        poses[p + 6] * x + poses[p + 7] * y + poses[p + 8] * z,
    )


@triton.jit
def _torque(poses, link: tl.constexpr, PRISMATIC: tl.constexpr, x, y, z, fx, fy, fz, mx, my, mz):
    """Return the torque at the joint before a link of a force and its moment about a point.

    At a prismatic joint it is the force along its axis.
    """
    p: tl.constexpr = 12 * link
    if PRISMATIC[link - 1]:
        found = poses[p + 2] * fx + poses[p + 5] * fy + poses[p + 8] * fz
    else:
        x = poses[p + 9] - x
        y = poses[p + 10] - y
        z = poses[p + 11] - z
        found = (
            poses[p + 2] * (mx - (y * fz - z * fy))
            + poses[p + 5] * (my - (z * fx - x * fz))
            + poses[p + 8] * (mz - (x * fy - y * fx))
        )
    return found


@triton.jit
def _distance(row, x, y, z):
    """Return distance and gradient to the obstacle of a row; see `batch.shape_distance`."""
    code = tl.load(row)
    r0 = tl.load(row + 1)
    r1 = tl.load(row + 2)
    r2 = tl.load(row + 3)
    r3 = tl.load(row + 4)
    r4 = tl.load(row + 5)
    r5 = tl.load(row + 6)
    r6 = tl.load(row + 7)
    r7 = tl.load(row + 8)
    r8 = tl.load(row + 9)
    x = x - tl.load(row + 10)
    y = y - tl.load(row + 11)
    z = z - tl.load(row + 12)
    width = tl.load(row + 13)
    depth = tl.load(row + 14)
    height = tl.load(row + 15)
    a = r0 * x + r1 * y + r2 * z
    b = r3 * x + r4 * y + r5 * z
    c = r6 * x + r7 * y + r8 * z
    flip = tl.where(c < 0.0, -1.0, 1.0)
    if code == 0.0:
        ea = tl.where(a < 0.0, -1.0, 1.0)
        eb = tl.where(b < 0.0, -1.0, 1.0)
        u = tl.abs(a) - width
        v = tl.abs(b) - depth
        w = tl.abs(c) - height
        deepest = tl.maximum(u, tl.maximum(v, w))
        fu = tl.maximum(u, 0.0)
        fv = tl.maximum(v, 0.0)
        fw = tl.maximum(w, 0.0)
        square = fu * fu + fv * fv + fw * fw
        length = tl.sqrt(tl.where(square > 0.0, square, 1.0))
        inside = square <= 0.0
        iu = tl.where(u >= deepest, 1.0, 0.0)
        iv = tl.where((v >= deepest) & (u < deepest), 1.0, 0.0)
        distance = tl.where(inside, deepest, length)
        ga = tl.where(inside, iu, fu / length) * ea
        gb = tl.where(inside, iv, fv / length) * eb
        gc = tl.where(inside, 1.0 - iu - iv, fw / length) * flip
    else:
        # A sphere is the body of revolution whose end is nowhere: its height does not count.
        round_ = code == 1.0
        across = a * a + b * b + tl.where(round_, 0.0, c * c)
        rho = tl.sqrt(tl.maximum(across, _LEAST))
        known = across > _LEAST
        ea = tl.where(known, a / rho, 1.0)
        eb = tl.where(known, b / rho, 0.0)
        ec = tl.where(round_, 0.0, tl.where(known, c / rho, 0.0))
        u = rho - width
        w = tl.where(round_, tl.abs(c) - height, _ABSENT)
        deepest = tl.maximum(u, w)
        fu = tl.maximum(u, 0.0)
        fw = tl.maximum(w, 0.0)
        square = fu * fu + fw * fw
        length = tl.sqrt(tl.where(square > 0.0, square, 1.0))
        inside = square <= 0.0
        iu = tl.where(u >= w, 1.0, 0.0)
        distance = tl.where(inside, deepest, length)
        gu = tl.where(inside, iu, fu / length)
        gw = tl.where(inside, 1.0 - iu, fw / length)
        ga = gu * ea
        gb = gu * eb
        gc = gu * ec + gw * flip
    return (
        distance,
        r0 * ga + r3 * gb + r6 * gc,
        r1 * ga + r4 * gb + r7 * gc,
        r2 * ga + r5 * gb + r8 * gc,
    )


@triton.jit
def _near_obstacles(obstacles, count, ball, poses, link: tl.constexpr, reach):
    """Return the set of obstacles, as bits, that spheres of a link may be near to."""
    x, y, z = _place(poses, link, tl.load(ball), tl.load(ball + 1), tl.load(ball + 2))
    farthest = tl.load(ball + 3) + reach
    near = tl.full([], 0, tl.int64)
    bit = tl.full([], 1, tl.int64)
    for o in range(count):
        found = _distance(obstacles + 16 * o, x, y, z)
        near += tl.where(tl.min(found[0] - farthest, axis=0) < 0.0, bit, 0)
        bit += bit
    return near


@triton.jit
def _relative(poses, inner: tl.constexpr, outer: tl.constexpr):
    """Return the pose of the outer link in the frame of the inner one."""
    i: tl.constexpr = 12 * inner
    j: tl.constexpr = 12 * outer
    dx = poses[j + 9] - poses[i + 9]
    dy = poses[j + 10] - poses[i + 10]
    dz = poses[j + 11] - poses[i + 11]
    turned = ()
    placed = ()
    for row in tl.static_range(3):
        a = poses[i + row]
        b = poses[i + 3 + row]
        c = poses[i + 6 + row]
        for column in tl.static_range(3):
            turned = turned + (
                a * poses[j + column] + b * poses[j + 3 + column] + c * poses[j + 6 + column],
            )
        placed = placed + (a * dx + b * dy + c * dz,)
    return turned + placed


@triton.jit
def _link_gap(relative, inner_ball, outer_ball):
    """Return a bound from below on the gap between spheres of two links."""
    x, y, z = _place(
        relative, 0, tl.load(outer_ball), tl.load(outer_ball + 1), tl.load(outer_ball + 2)
    )
    x -= tl.load(inner_ball)
    y -= tl.load(inner_ball + 1)
    z -= tl.load(inner_ball + 2)
    return tl.sqrt(x * x + y * y + z * z) - tl.load(inner_ball + 3) - tl.load(outer_ball + 3)


@triton.jit
def _pair_excess(
    relative,
    spheres,
    masks,
    offsets,
    inner: tl.constexpr,
    outer: tl.constexpr,
    reach,
    part,
    LINKS: tl.constexpr,
    PARTS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Return the least of |a - b|² - (r_a + r_b + reach)² over the pairs of two links."""
    least = tl.full([BLOCK], _FAR, tl.float32)
    first = tl.load(offsets + inner)
    last = tl.load(offsets + inner + 1)
    for v in range(tl.load(offsets + outer) + part, tl.load(offsets + outer + 1), PARTS):
        sphere = spheres + 4 * v
        x, y, z = _place(relative, 0, tl.load(sphere), tl.load(sphere + 1), tl.load(sphere + 2))
        radius = tl.load(sphere + 3) + reach
        mask = tl.load(masks + v * LINKS + inner)
        for u in range(first, last):
            other = spheres + 4 * u
            dx = tl.load(other) - x
            dy = tl.load(other + 1) - y
            dz = tl.load(other + 2) - z
            both = tl.load(other + 3) + radius
            # What is no pair is kept out of reach.
            both = tl.where(((mask >> (u - first).to(tl.int64)) & 1) == 1, both, 0.0)
            least = tl.minimum(least, dx * dx + dy * dy + dz * dz - both * both)
    return least


@triton.jit
def collisions(
    trajectories,
    gradient,
    values,
    chain,
    spheres,
    offsets,
    balls,
    obstacles,
    obstacle_count,
    scale,
    own_spheres,
    own_offsets,
    own_balls,
    masks,
    per_step,
    lower,
    upper,
    sphere_stride,
    offset_stride,
    ball_stride,
    obstacle_stride,
    own_sphere_stride,
    own_offset_stride,
    own_ball_stride,
    mask_stride,
    particles,
    steps,
    first,
    length,
    batch_values,
    batch_gradient,
    obstacle_weight,
    width,
    margin,
    truncation,
    own_weight,
    own_width,
    own_margin,
    velocity_weight,
    velocity_scale,
    limit_weight,
    own_scale,
    JOINTS: tl.constexpr,
    PRISMATIC: tl.constexpr,
    PAIRS: tl.constexpr,
    CUTOFF: tl.constexpr,
    OBSTACLES: tl.constexpr,
    OWN: tl.constexpr,
    ADD: tl.constexpr,
    VALUES: tl.constexpr,
    PARTS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Write the gradient of obstacles, self-collision, velocities and joint limits.

    The grid is (blocks of particles times steps, B, PARTS). Each part takes its share of spheres
    and writes to a gradient of its own, (PARTS, B, P, T, n), which are added up afterwards.

    With VALUES the weights are ignored: the unweighted costs of each configuration are written,
    (PARTS, 4, B, P, T).
    """
    LINKS: tl.constexpr = JOINTS + 1
    scene = tl.program_id(1).to(tl.int64)
    part = tl.program_id(2)
    count = particles * length
    index = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = index < count
    inside = tl.minimum(index, count - 1)
    particle = inside // length
    step = first + inside - particle * length
    at = scene * particles * steps + particle.to(tl.int64) * steps + step
    angles = ()
    torque = ()
    for joint in tl.static_range(JOINTS):
        angles = angles + (tl.load(trajectories + at * JOINTS + joint),)
        torque = torque + (tl.zeros([BLOCK], tl.float32),)
    poses = _poses(chain, angles, JOINTS, PRISMATIC, BLOCK)
    if OBSTACLES:
        spheres += scene * sphere_stride
        offsets += scene * offset_stride
        balls += scene * ball_stride
        obstacles += scene * obstacle_stride
        there = tl.load(obstacle_count + scene)
        factor = tl.load(scale + scene)
        if not VALUES:
            factor = factor * obstacle_weight
        steep = 1.0 / width
        total = tl.zeros([BLOCK], tl.float32)
        # From the tip to the base: the force on all links from the one at hand outwards.
        fx = tl.zeros([BLOCK], tl.float32)
        fy = tl.zeros([BLOCK], tl.float32)
        fz = tl.zeros([BLOCK], tl.float32)
        mx = tl.zeros([BLOCK], tl.float32)
        my = tl.zeros([BLOCK], tl.float32)
        mz = tl.zeros([BLOCK], tl.float32)
        outer = ()
        for link in tl.static_range(JOINTS, 0, -1):
            begin = tl.load(offsets + link)
            end = tl.load(offsets + link + 1)
            if end > begin:
                reach = tl.minimum(margin + CUTOFF * width, truncation)
                near = _near_obstacles(obstacles, there, balls + 4 * link, poses, link, reach)
                if near != 0:
                    for s in range(begin + part, end, PARTS):
                        sphere = spheres + 4 * s
                        x, y, z = _place(
                            poses, link, tl.load(sphere), tl.load(sphere + 1), tl.load(sphere + 2)
                        )
                        radius = tl.load(sphere + 3) + margin
                        best = tl.full([BLOCK], _FAR, tl.float32)
                        gx = tl.zeros([BLOCK], tl.float32)
                        gy = tl.zeros([BLOCK], tl.float32)
                        gz = tl.zeros([BLOCK], tl.float32)
                        for o in range(there):
                            if ((near >> o) & 1) == 1:
                                d, ax, ay, az = _distance(obstacles + 16 * o, x, y, z)
                                nearer = d < best
                                best = tl.where(nearer, d, best)
                                gx = tl.where(nearer, ax, gx)
                                gy = tl.where(nearer, ay, gy)
                                gz = tl.where(nearer, az, gz)
                        limit = tl.minimum(radius + CUTOFF * width, truncation)
                        occupancy = 1.0 / (1.0 + tl.exp((best - radius) * steep))
                        square = occupancy * occupancy
                        active = best < limit
                        slope = tl.where(active, -2.0 * steep * square * (1.0 - occupancy), 0.0)
                        if VALUES:
                            floor = 1.0 / (1.0 + tl.exp((limit - radius) * steep))
                            total += tl.where(active, square - floor * floor, 0.0)
                        gx *= slope
                        gy *= slope
                        gz *= slope
                        fx += gx
                        fy += gy
                        fz += gz
                        mx += y * gz - z * gy
                        my += z * gx - x * gz
                        mz += x * gy - y * gx
            turned = _torque(poses, link, PRISMATIC, 0.0, 0.0, 0.0, fx, fy, fz, mx, my, mz)
            outer = (factor * turned,) + outer
        torque = outer
        if VALUES:
            where = values + part * 4 * batch_values + at
            old = tl.load(where, mask=valid, other=0.0)
            tl.store(where, old + factor * total, mask=valid)
    if OWN:
        own_spheres += scene * own_sphere_stride
        own_offsets += scene * own_offset_stride
        own_balls += scene * own_ball_stride
        masks += scene * mask_stride
        own_steep = 1.0 / own_width
        own_reach = own_margin + CUTOFF * own_width
        weight = own_scale
        if not VALUES:
            weight = own_scale * own_weight
        own_total = tl.zeros([BLOCK], tl.float32)
        for pair in tl.static_range(len(PAIRS) // 2):
            fx = tl.zeros([BLOCK], tl.float32)
            fy = tl.zeros([BLOCK], tl.float32)
            fz = tl.zeros([BLOCK], tl.float32)
            mx = tl.zeros([BLOCK], tl.float32)
            my = tl.zeros([BLOCK], tl.float32)
            mz = tl.zeros([BLOCK], tl.float32)
            relative = _relative(poses, PAIRS[2 * pair], PAIRS[2 * pair + 1])
            gap = _link_gap(
                relative, own_balls + 4 * PAIRS[2 * pair], own_balls + 4 * PAIRS[2 * pair + 1]
            )
            if tl.min(gap, axis=0) < own_reach:
                least = _pair_excess(
                    relative,
                    own_spheres,
                    masks,
                    own_offsets,
                    PAIRS[2 * pair],
                    PAIRS[2 * pair + 1],
                    own_reach,
                    part,
                    LINKS,
                    PARTS,
                    BLOCK,
                )
                if tl.min(least, axis=0) < 0.0:
                    begin = tl.load(own_offsets + PAIRS[2 * pair])
                    end = tl.load(own_offsets + PAIRS[2 * pair] + 1)
                    for v in range(
                        tl.load(own_offsets + PAIRS[2 * pair + 1]) + part,
                        tl.load(own_offsets + PAIRS[2 * pair + 1] + 1),
                        PARTS,
                    ):
                        sphere = own_spheres + 4 * v
                        x, y, z = _place(
                            relative,
                            0,
                            tl.load(sphere),
                            tl.load(sphere + 1),
                            tl.load(sphere + 2),
                        )
                        radius = tl.load(sphere + 3)
                        mask = tl.load(masks + v * LINKS + PAIRS[2 * pair])
                        for u in range(begin, end):
                            if ((mask >> (u - begin).to(tl.int64)) & 1) == 1:
                                other = own_spheres + 4 * u
                                cx = tl.load(other)
                                cy = tl.load(other + 1)
                                cz = tl.load(other + 2)
                                both = tl.load(other + 3) + radius
                                dx = cx - x
                                dy = cy - y
                                dz = cz - z
                                between_ = tl.sqrt(tl.maximum(dx * dx + dy * dy + dz * dz, 1e-18))
                                occupancy = 1.0 / (
                                    1.0 + tl.exp((between_ - both - own_margin) * own_steep)
                                )
                                square = occupancy * occupancy
                                active = between_ < both + own_reach
                                slope = tl.where(
                                    active,
                                    -2.0 * own_steep * square * (1.0 - occupancy) / between_,
                                    0.0,
                                )
                                if VALUES:
                                    floor = 1.0 / (
                                        1.0 + tl.exp((own_reach - own_margin) * own_steep)
                                    )
                                    own_total += tl.where(active, square - floor * floor, 0.0)
                                dx *= slope
                                dy *= slope
                                dz *= slope
                                fx += dx
                                fy += dy
                                fz += dz
                                mx += cy * dz - cz * dy
                                my += cz * dx - cx * dz
                                mz += cx * dy - cy * dx
            # Force and moment on the inner link, in its frame and about its origin. The outer link
            # has their negative, so only the joints between the two feel them.
            fx, fy, fz = _rotated(poses, PAIRS[2 * pair], fx, fy, fz)
            mx, my, mz = _rotated(poses, PAIRS[2 * pair], mx, my, mz)
            x, y, z = _place(poses, PAIRS[2 * pair], 0.0, 0.0, 0.0)
            added = ()
            for joint in tl.static_range(JOINTS):
                if joint >= PAIRS[2 * pair] and joint < PAIRS[2 * pair + 1]:
                    turned = _torque(poses, joint + 1, PRISMATIC, x, y, z, fx, fy, fz, mx, my, mz)
                    added = added + (torque[joint] - weight * turned,)
                else:
                    added = added + (torque[joint],)
            torque = added
        if VALUES:
            where = values + (part * 4 + 1) * batch_values + at
            tl.store(where, weight * own_total, mask=valid)
        # One part alone has the limits; they cost less than a branch around them.
        once = tl.where(part == 0, 1.0, 0.0)
        velocity_total = tl.zeros([BLOCK], tl.float32)
        limit_total = tl.zeros([BLOCK], tl.float32)
        onwards = tl.where(step + 1 < steps, JOINTS, 0)
        backwards = tl.where(step > 0, JOINTS, 0)
        added = ()
        for joint in tl.static_range(JOINTS):
            here = trajectories + at * JOINTS + joint
            speed = tl.load(per_step + joint)
            q = angles[joint]
            ahead = (tl.load(here + onwards) - q) * speed
            behind = (q - tl.load(here - backwards)) * speed
            ahead = ahead - tl.minimum(tl.maximum(ahead, -1.0), 1.0)
            behind = behind - tl.minimum(tl.maximum(behind, -1.0), 1.0)
            beyond = q - tl.minimum(tl.maximum(q, tl.load(lower + joint)), tl.load(upper + joint))
            velocity_total += velocity_scale * ahead * ahead
            limit_total += own_scale * beyond * beyond
            slope = velocity_weight * velocity_scale * speed * (behind - ahead)
            slope += limit_weight * own_scale * beyond
            added = added + (torque[joint] + 2.0 * once * slope,)
        torque = added
        if VALUES:
            where = values + (part * 4 + 2) * batch_values + at
            tl.store(where, once * velocity_total, mask=valid)
            tl.store(where + batch_values, once * limit_total, mask=valid)
    if not VALUES:
        for joint in tl.static_range(JOINTS):
            where = gradient + part * batch_gradient + at * JOINTS + joint
            found = torque[joint]
            if ADD:
                found += tl.load(where, mask=valid, other=0.0)
            tl.store(where, found, mask=valid)


@triton.jit
def _tool_offset(
    trajectories,
    chain,
    step,
    share,
    point,
    lower,
    upper,
    term,
    start,
    inv_sigma,
    steps,
    JOINTS: tl.constexpr,
    PRISMATIC: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Return poses at the phase of a term, the carried point, and its offset from the box."""
    at = start + tl.load(step + term)
    part = tl.load(share + term)
    angles = ()
    for joint in tl.static_range(JOINTS):
        here = trajectories + at * JOINTS + joint
        angles = angles + ((1.0 - part) * tl.load(here) + part * tl.load(here + JOINTS),)
    poses = _poses(chain, angles, JOINTS, PRISMATIC, BLOCK)
    row = point + 3 * term
    x, y, z = _place(poses, JOINTS, tl.load(row), tl.load(row + 1), tl.load(row + 2))
    low = lower + 3 * term
    high = upper + 3 * term
    u = (x - tl.minimum(tl.maximum(x, tl.load(low)), tl.load(high))) * inv_sigma
    v = (y - tl.minimum(tl.maximum(y, tl.load(low + 1)), tl.load(high + 1))) * inv_sigma
    w = (z - tl.minimum(tl.maximum(z, tl.load(low + 2)), tl.load(high + 2))) * inv_sigma
    return poses, x, y, z, u, v, w


@triton.jit
def tools(
    trajectories,
    gradient,
    chain,
    step,
    share,
    point,
    lower,
    upper,
    log_weight,
    group,
    terms,
    particles,
    steps,
    inv_sigma,
    JOINTS: tl.constexpr,
    PRISMATIC: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Add the gradient of boxes for carried points, of all groups of `ToolTables`.

    The grid is (blocks of particles, B). A program has its particles for itself, so it adds up
    without atomic operations, in the same order each time.
    """
    scene = tl.program_id(1).to(tl.int64)
    index = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = index < particles
    start = (scene * particles + tl.minimum(index, particles - 1)) * steps
    step += scene * terms
    share += scene * terms
    point += scene * terms * 3
    lower += scene * terms * 3
    upper += scene * terms * 3
    log_weight += scene * terms
    group += scene * terms
    for h in range(terms):
        mine = tl.load(group + h)
        if mine > 0:
            poses, x, y, z, u, v, w = _tool_offset(
                trajectories,
                chain,
                step,
                share,
                point,
                lower,
                upper,
                h,
                start,
                inv_sigma,
                steps,
                JOINTS,
                PRISMATIC,
                BLOCK,
            )
            own = tl.load(log_weight + h) - 0.5 * (u * u + v * v + w * w)
            # The share of this option among all of its group: 1 / sum of exp(other - own).
            total = tl.full([BLOCK], 1.0, tl.float32)
            for other in range(terms):
                if (tl.load(group + other) == mine) & (other != h):
                    _, _, _, _, a, b, c = _tool_offset(
                        trajectories,
                        chain,
                        step,
                        share,
                        point,
                        lower,
                        upper,
                        other,
                        start,
                        inv_sigma,
                        steps,
                        JOINTS,
                        PRISMATIC,
                        BLOCK,
                    )
                    there = tl.load(log_weight + other) - 0.5 * (a * a + b * b + c * c)
                    total += tl.exp(tl.minimum(there - own, 80.0))
            member = inv_sigma / total
            u *= member
            v *= member
            w *= member
            at = (start + tl.load(step + h)) * JOINTS
            part = tl.load(share + h)
            for joint in tl.static_range(JOINTS):
                turned = _torque(poses, joint + 1, PRISMATIC, x, y, z, u, v, w, 0.0, 0.0, 0.0)
                where = gradient + at + joint
                found = tl.load(where, mask=valid, other=0.0)
                tl.store(where, found + (1.0 - part) * turned, mask=valid)
                found = tl.load(where + JOINTS, mask=valid, other=0.0)
                tl.store(where + JOINTS, found + part * turned, mask=valid)


@triton.jit
def _clearances(
    poses,
    spheres,
    offsets,
    balls,
    obstacles,
    there,
    masks,
    horizon,
    JOINTS: tl.constexpr,
    PAIRS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Return the least gap to obstacles and, at most the horizon, between the robot's spheres."""
    LINKS: tl.constexpr = JOINTS + 1
    best = tl.full([BLOCK], _FAR, tl.float32)
    for link in tl.static_range(JOINTS, 0, -1):
        begin = tl.load(offsets + link)
        end = tl.load(offsets + link + 1)
        if end > begin:
            # No nearer than what is found already is no news to any of the block.
            farthest = tl.max(best, axis=0)
            near = _near_obstacles(obstacles, there, balls + 4 * link, poses, link, farthest)
            if near != 0:
                for s in range(begin, end):
                    sphere = spheres + 4 * s
                    x, y, z = _place(
                        poses, link, tl.load(sphere), tl.load(sphere + 1), tl.load(sphere + 2)
                    )
                    radius = tl.load(sphere + 3)
                    for o in range(there):
                        if ((near >> o) & 1) == 1:
                            found = _distance(obstacles + 16 * o, x, y, z)
                            best = tl.minimum(best, found[0] - radius)
    own = tl.zeros([BLOCK], tl.float32) + horizon
    for pair in tl.static_range(len(PAIRS) // 2):
        relative = _relative(poses, PAIRS[2 * pair], PAIRS[2 * pair + 1])
        gap = _link_gap(relative, balls + 4 * PAIRS[2 * pair], balls + 4 * PAIRS[2 * pair + 1])
        if tl.min(gap, axis=0) < horizon:
            least = _pair_excess(
                relative,
                spheres,
                masks,
                offsets,
                PAIRS[2 * pair],
                PAIRS[2 * pair + 1],
                horizon,
                0,
                LINKS,
                1,
                BLOCK,
            )
            if tl.min(least, axis=0) < 0.0:
                begin = tl.load(offsets + PAIRS[2 * pair])
                end = tl.load(offsets + PAIRS[2 * pair] + 1)
                for v in range(
                    tl.load(offsets + PAIRS[2 * pair + 1]),
                    tl.load(offsets + PAIRS[2 * pair + 1] + 1),
                ):
                    sphere = spheres + 4 * v
                    x, y, z = _place(
                        relative, 0, tl.load(sphere), tl.load(sphere + 1), tl.load(sphere + 2)
                    )
                    radius = tl.load(sphere + 3)
                    mask = tl.load(masks + v * LINKS + PAIRS[2 * pair])
                    for u in range(begin, end):
                        if ((mask >> (u - begin).to(tl.int64)) & 1) == 1:
                            other = spheres + 4 * u
                            dx = tl.load(other) - x
                            dy = tl.load(other + 1) - y
                            dz = tl.load(other + 2) - z
                            apart = tl.sqrt(dx * dx + dy * dy + dz * dz)
                            own = tl.minimum(own, apart - radius - tl.load(other + 3))
    return best, own


@triton.jit
def gaps(
    trajectories,
    gap,
    own_gap,
    chain,
    spheres,
    offsets,
    balls,
    obstacles,
    obstacle_count,
    masks,
    sphere_stride,
    offset_stride,
    ball_stride,
    obstacle_stride,
    mask_stride,
    particles,
    steps,
    horizon,
    JOINTS: tl.constexpr,
    PRISMATIC: tl.constexpr,
    PAIRS: tl.constexpr,
    BLOCK: tl.constexpr,
):
    """Write the gaps to obstacles and of the robot to itself (B, P, T) at configurations.

    The grid is (blocks of particles times steps, B).
    """
    scene = tl.program_id(1).to(tl.int64)
    count = particles * steps
    index = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    valid = index < count
    at = scene * count + tl.minimum(index, count - 1)
    angles = ()
    for joint in tl.static_range(JOINTS):
        angles = angles + (tl.load(trajectories + at * JOINTS + joint),)
    poses = _poses(chain, angles, JOINTS, PRISMATIC, BLOCK)
    best, own = _clearances(
        poses,
        spheres + scene * sphere_stride,
        offsets + scene * offset_stride,
        balls + scene * ball_stride,
        obstacles + scene * obstacle_stride,
        tl.load(obstacle_count + scene),
        masks + scene * mask_stride,
        horizon,
        JOINTS,
        PAIRS,
        BLOCK,
    )
    tl.store(gap + scene * count + index, best, mask=valid)
    tl.store(own_gap + scene * count + index, own, mask=valid)
