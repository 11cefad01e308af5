//! The homing methods of 6098h (DSP 402 v2, chapter on homing; CiA 402 numbers), as data: which switch is looked for,
//! how its edge is crossed, and whether an index pulse follows.
//!
//! Methods 17 to 30 are 1 to 14 without the index pulse.

use super::machine::{HOME_SWITCH, NEGATIVE_LIMIT, POSITIVE_LIMIT};

/// What a method does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Method {
    /// Home is where the axis stands (35, 37).
    Here,
    /// The next index pulse in a direction (33, 34).
    Index {
        /// Toward larger positions.
        up: bool,
    },
    /// An edge of a switch.
    Edge(Edge),
}

/// A method that looks for the edge of a switch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Edge {
    /// Bit of 60FDh.
    pub(super) switch: u32,
    /// Search direction while the switch is not active at the start: toward larger positions.
    pub(super) search_up: bool,
    /// The search turns round at a limit switch.
    pub(super) turns: bool,
    /// The home edge is crossed toward larger positions.
    pub(super) up: bool,
    /// The home edge is the one where the switch becomes active; else where it becomes inactive.
    pub(super) to_active: bool,
    /// Home is the first index pulse behind the edge; else the edge.
    pub(super) index: bool,
}

impl Method {
    /// The method of a number; none for one that does not exist or is not modelled.
    pub(super) fn of(number: i8) -> Option<Method> {
        let index = number <= 14;
        let (switch, search_up, turns, up, to_active) = match number {
            1 | 17 => (NEGATIVE_LIMIT, false, false, true, false),
            2 | 18 => (POSITIVE_LIMIT, true, false, false, false),
            // A home switch that is active to the positive end.
            3 | 19 => (HOME_SWITCH, true, false, false, false),
            4 | 20 => (HOME_SWITCH, true, false, true, true),
            // A home switch that is active to the negative end.
            5 | 21 => (HOME_SWITCH, false, false, true, false),
            6 | 22 => (HOME_SWITCH, false, false, false, true),
            // A home switch between the limits, looked for in the positive direction first.
            7 | 23 => (HOME_SWITCH, true, true, false, false),
            8 | 24 => (HOME_SWITCH, true, true, true, true),
            9 | 25 => (HOME_SWITCH, true, true, false, true),
            10 | 26 => (HOME_SWITCH, true, true, true, false),
            // And in the negative direction first.
            11 | 27 => (HOME_SWITCH, false, true, true, false),
            12 | 28 => (HOME_SWITCH, false, true, false, true),
            13 | 29 => (HOME_SWITCH, false, true, true, true),
            14 | 30 => (HOME_SWITCH, false, true, false, false),
            33 => return Some(Method::Index { up: false }),
            34 => return Some(Method::Index { up: true }),
            35 | 37 => return Some(Method::Here),
            _ => return None,
        };
        Some(Method::Edge(Edge {
            switch,
            search_up,
            turns,
            up,
            to_active,
            index,
        }))
    }
}
