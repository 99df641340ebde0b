//! Events and the chain in the JSON of Foxglove's well-known schemas, which other viewers know too.
//!
//! The chain hangs in the plane x–z: absolute angles from the downward vertical, as in the model.

use libm::{cos, sin};
use loopbound_shared::clock::NS_PER_S;
use serde_json::{Value, json};

use crate::event::{Event, EventKind, cause_of};
use crate::tracker::Row;

/// Schema of `foxglove.Log`.
pub const LOG_SCHEMA: &str = r#"{"title":"foxglove.Log","type":"object","properties":{
"timestamp":{"type":"object","title":"time","properties":{"sec":{"type":"integer","minimum":0},"nsec":{"type":"integer","minimum":0,"maximum":999999999}}},
"level":{"title":"foxglove.LogLevel","oneOf":[{"title":"UNKNOWN","const":0},{"title":"DEBUG","const":1},{"title":"INFO","const":2},{"title":"WARNING","const":3},{"title":"ERROR","const":4},{"title":"FATAL","const":5}]},
"message":{"type":"string"},"name":{"type":"string"},"file":{"type":"string"},"line":{"type":"integer","minimum":0}}}"#;

/// Schema of `foxglove.SceneUpdate`, the parts that are used.
pub const SCENE_SCHEMA: &str = include_str!("scene_update.json");

const INFO: u8 = 2;
const WARNING: u8 = 3;
const ERROR: u8 = 4;

fn time(time_ns: u64) -> Value {
    json!({"sec": time_ns / NS_PER_S, "nsec": time_ns % NS_PER_S})
}

/// An event as `foxglove.Log`: the line of `events.jsonl`, with a level to filter by.
#[must_use]
pub fn log_line(event: &Event, time_ns: u64) -> String {
    let level = match event.kind {
        EventKind::Bound { verdict: "designed_hold", .. } => INFO,
        EventKind::FirstSeen | EventKind::Happening(_) | EventKind::Level { inside: true, .. } => INFO,
        EventKind::Bound { .. } | EventKind::Promise { .. } => ERROR,
        EventKind::Late { .. }
        | EventKind::Missed { .. }
        | EventKind::Gap { .. }
        | EventKind::Rejected { .. }
        | EventKind::Level { .. } => WARNING,
    };
    let name = cause_of(event).map_or_else(|| event.kind.name(), crate::cause::Cause::name);
    json!({
        "timestamp": time(time_ns), "level": level, "message": event.to_json(), "name": name,
        "file": "", "line": event.tick,
    })
    .to_string()
}

/// Where the joints are: the suspension first, then the end of each link, m.
#[must_use]
pub fn joints(q: &[f64], length_m: &[f64]) -> Vec<[f64; 2]> {
    let mut at = [0.0, 0.0];
    let ends = q.iter().zip(length_m).map(|(angle, length)| {
        at = [at[0] + length * sin(*angle), at[1] - length * cos(*angle)];
        at
    });
    std::iter::once([0.0, 0.0]).chain(ends).collect()
}

/// The chain and the ghost of its reference, as `foxglove.SceneUpdate`.
#[must_use]
pub fn update(row: &Row, length_m: &[f64], time_ns: u64) -> String {
    let reach: f64 = length_m.iter().sum();
    let ghost = entity("reference", &row.q_d, length_m, reach, [0.55, 0.55, 0.6, 0.5], time_ns);
    let chain = entity("chain", &row.q, length_m, reach, [0.12, 0.47, 0.87, 1.0], time_ns);
    json!({"deletions": [], "entities": [ghost, chain]}).to_string()
}

fn entity(id: &str, q: &[f64], length_m: &[f64], reach: f64, [r, g, b, a]: [f64; 4], time_ns: u64) -> Value {
    let colour = json!({"r": r, "g": g, "b": b, "a": a});
    let upright = json!({"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0});
    let origin = json!({"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": upright});
    let points: Vec<Value> = joints(q, length_m).into_iter().map(|[x, z]| json!({"x": x, "y": 0.0, "z": z})).collect();
    let size = 0.05 * reach;
    let spheres: Vec<Value> = points
        .iter()
        .map(|point| {
            let pose = json!({"position": point, "orientation": upright});
            json!({"pose": pose, "size": {"x": size, "y": size, "z": size}, "color": colour})
        })
        .collect();
    let line = json!({
        "type": 0, "pose": origin, "thickness": 0.02 * reach, "scale_invariant": false,
        "points": points, "color": colour, "colors": [], "indices": [],
    });
    json!({
        "timestamp": time(time_ns), "frame_id": "world", "id": id, "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": false, "metadata": [], "arrows": [], "cubes": [], "spheres": spheres, "cylinders": [],
        "lines": [line], "triangles": [], "texts": [], "models": [],
    })
}
