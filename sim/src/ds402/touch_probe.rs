//! Touch probes: 60B8h to 60BDh, with time stamps (60D1h to 60D4h) and counters (60D5h to 60D8h) of their edges.
//!
//! | 60B8h, of probe 1 | 60B9h, of probe 1 |
//! |---|---|
//! | bit 0: enabled | bit 0: is enabled |
//! | bit 1: each edge, else the first one | bit 1: a positive edge is stored |
//! | bits 2, 3: the source, 0 for the input | bit 2: a negative edge is stored |
//! | bit 4: positive edge, bit 5: negative edge | |
//!
//! Probe 2 has the upper bytes. Stored bits are cleared with bit 0 of 60B8h, or with the bit of their edge. Positions, time stamps and counters
//! keep their values. An edge lies within a drive cycle, and its position on the way of the shaft in that. What no document says and is
//! therefore assumed: a probe is sensitive from the cycle after the one in which 60B8h was seen. Other sources than the input have no edges.

use core::time::Duration;
use std::collections::VecDeque;

use super::axis::Axis;
use super::machine::Mark;
use super::objects::{self, Address};

/// Of one edge of one probe: its bits in the bytes of 60B8h and 60B9h, and its objects.
struct EdgeObjects {
    function: i64,
    status: i64,
    position: Address,
    time: Address,
    counter: Address,
}

const fn edge(negative: u8, position: u16, time: u16, counter: u16) -> EdgeObjects {
    EdgeObjects {
        function: 1 << (4 + negative),
        status: 1 << (1 + negative),
        position: (position, 0),
        time: (time, 0),
        counter: (counter, 0),
    }
}

/// Positive and negative edge of both probes.
const EDGES: [[EdgeObjects; 2]; 2] = [
    [
        edge(0, 0x60BA, 0x60D1, 0x60D5),
        edge(1, 0x60BB, 0x60D2, 0x60D6),
    ],
    [
        edge(0, 0x60BC, 0x60D3, 0x60D7),
        edge(1, 0x60BD, 0x60D4, 0x60D8),
    ],
];

const ENABLE: i64 = 1 << 0;
const EACH: i64 = 1 << 1;
const SOURCE: i64 = 3 << 2;

#[derive(Debug, Clone, Default)]
pub(super) struct TouchProbes {
    probes: [ProbeState; 2],
    /// 60B9h of this cycle and of those before it that are not shown yet.
    shown: VecDeque<i64>,
    /// Time of the last cycle, and where the shaft was, from the machine's zero.
    last: Option<(Duration, f64)>,
}

#[derive(Debug, Clone, Default)]
struct ProbeState {
    /// Its byte of 60B8h, as the drive has seen it.
    function: i64,
    /// Its byte of 60B9h.
    status: i64,
    /// What a test does to its input: when, and to which level.
    pending: VecDeque<(Duration, bool)>,
    by_hand: bool,
    /// The input is active by the machine's mark.
    on_mark: bool,
}

/// A change of an input within a cycle.
struct Change {
    /// Which part of the cycle has passed then.
    share: f64,
    by_hand: bool,
    active: bool,
}

impl Axis {
    /// Sets the input of touch probe 1 or 2 at this time, which may lie within a cycle to come: the drive then holds the position at which the
    /// shaft is on its way between the cycles. It is active by this or by the machine's mark
    /// ([`Machine::probes`](super::Machine::probes)). Times of one probe are to rise; one that is over counts as the beginning of the
    /// next cycle.
    ///
    /// ```
    /// use core::time::Duration;
    /// use servocrab_sim::ds402::{Axis, Behaviour};
    ///
    /// let mut axis = Axis::new(Behaviour::generic());
    /// axis.set(0x60B8, 0, 0x0011)?;
    /// axis.cycle(Duration::from_millis(1));
    /// axis.set_probe_input(1, true, Duration::from_micros(1_400));
    /// axis.cycle(Duration::from_millis(2));
    /// assert_eq!(axis.get(0x60B9, 0), Some(0x0003)); // enabled, and a positive edge is stored
    /// assert_eq!(axis.get(0x60D1, 0), Some(1_400_000));
    /// # Ok::<(), servocrab_sim::ds402::SetError>(())
    /// ```
    pub fn set_probe_input(&mut self, probe: usize, active: bool, at: Duration) {
        let probe = probe.checked_sub(1);
        if let Some(probe) = probe.and_then(|probe| self.touch_probes.probes.get_mut(probe)) {
            probe.pending.push_back((at, active));
        }
    }

    /// Both probes in this cycle: first what has happened since the last one, then what 60B8h says from now on.
    pub(super) fn run_touch_probes(&mut self) {
        let at = self.shaft.position + self.machine_offset as f64;
        let last = self.touch_probes.last.replace((self.now, at));
        let (since, from) = last.unwrap_or((self.now, at));
        for (number, edges) in EDGES.iter().enumerate() {
            let Some(mut probe) = self.touch_probes.probes.get(number).cloned() else {
                continue;
            };
            let mark = self.behaviour.machine.probes.get(number).copied().flatten();
            if last.is_none() {
                probe.on_mark = mark.is_some_and(|mark| mark.contains(at));
            }
            for change in probe.changes((since, self.now), mark, (from, at)) {
                let was = probe.by_hand || probe.on_mark;
                if change.by_hand {
                    probe.by_hand = change.active;
                } else {
                    probe.on_mark = change.active;
                }
                let is = probe.by_hand || probe.on_mark;
                if was == is {
                    continue;
                }
                let time = since + self.now.saturating_sub(since).mul_f64(change.share);
                let position = from + (at - from) * change.share;
                self.meet_edge(&mut probe, &edges[usize::from(!is)], time, position);
            }
            if !self.disturbances.deaf_to_touch_probe {
                let function = self.objects.value(objects::TOUCH_PROBE_FUNCTION);
                probe.obey(function >> (8 * number) & 0xFF, edges);
            }
            if let Some(known) = self.touch_probes.probes.get_mut(number) {
                *known = probe;
            }
        }
        let [first, second] = &self.touch_probes.probes;
        let status = first.status | second.status << 8;
        let lag = self.disturbances.touch_probe_lag_cycles as usize;
        let shown = &mut self.touch_probes.shown;
        shown.push_back(status);
        while shown.len() > lag + 1 {
            shown.pop_front();
        }
        let status = shown.front().copied().unwrap_or(status);
        self.objects.put(objects::TOUCH_PROBE_STATUS, status);
    }

    fn meet_edge(
        &mut self,
        probe: &mut ProbeState,
        edge: &EdgeObjects,
        time: Duration,
        machine_position: f64,
    ) {
        let is_for_it = probe.status & ENABLE != 0
            && probe.function & edge.function != 0
            && probe.function & SOURCE == 0;
        let is_stored = probe.status & edge.status != 0;
        if !is_for_it || is_stored && probe.function & EACH == 0 {
            return;
        }
        probe.status |= edge.status;
        let counts = (machine_position - self.machine_offset as f64).round() as i64;
        let position = self.in_range(self.turned(counts));
        let counter = self.objects.value(edge.counter);
        self.objects.put(edge.position, i64::from(position as i32));
        // The lower half of the time.
        self.objects
            .put(edge.time, (time.as_nanos() & 0xFFFF_FFFF) as i64);
        self.objects.put(edge.counter, (counter + 1) & 0xFFFF);
    }
}

impl ProbeState {
    /// What has changed the input in a cycle, in order.
    fn changes(
        &mut self,
        (since, now): (Duration, Duration),
        mark: Option<Mark>,
        (from, to): (f64, f64),
    ) -> Vec<Change> {
        let mut changes = Vec::new();
        let length = now.saturating_sub(since).as_secs_f64();
        while let Some((at, active)) = self.pending.front().copied().filter(|(at, _)| *at <= now) {
            self.pending.pop_front();
            let passed = at.saturating_sub(since).as_secs_f64();
            changes.push(Change {
                share: if length > 0.0 { passed / length } else { 1.0 },
                by_hand: true,
                active,
            });
        }
        let edges = mark.map(|mark| mark.edges(from, to)).unwrap_or_default();
        changes.extend(edges.into_iter().map(|(at, active)| Change {
            share: (at - from) / (to - from),
            by_hand: false,
            active,
        }));
        changes.sort_by(|one, other| one.share.total_cmp(&other.share));
        changes
    }

    fn obey(&mut self, function: i64, edges: &[EdgeObjects; 2]) {
        self.function = function;
        if function & ENABLE == 0 {
            self.status = 0;
            return;
        }
        self.status |= ENABLE;
        for edge in edges {
            if function & edge.function == 0 {
                self.status &= !edge.status;
            }
        }
    }
}
