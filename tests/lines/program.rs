//! What a program does on such a line beside SDO traffic: moves, looking after its devices; and what each answer must be.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    rc::Rc,
    time::Duration,
};

use servocrab::{Axis, BufferMode, Failure, Network, NetworkError, SetPoint, bus::NetworkEvent};

use crate::{
    judge::{AxisPlace, Judge},
    random::Random,
    tasks::Clock,
};

pub const MS: Duration = Duration::from_millis(1);
/// Longer than any command of an axis takes, but for a move.
const COMMAND_LIMIT: Duration = Duration::from_secs(30);
/// Longer than any SDO transfer takes: some replies of a second each, behind those of others.
pub const SDO_LIMIT: Duration = Duration::from_secs(40);
/// Longer than it takes to lead a device back, or to fail with it.
pub const RECOVER_LIMIT: Duration = Duration::from_secs(60);

/// Moments, by the numbers of drives.
pub type Times = Rc<RefCell<BTreeMap<usize, Duration>>>;

/// What all parts of a program share.
#[derive(Clone)]
pub struct Common {
    pub clock: Clock,
    pub judge: Judge,
    pub seed: u64,
    /// What devices say comes as they say it.
    pub honest: bool,
    /// Nothing new is begun any more.
    pub ending: Rc<Cell<bool>>,
    /// What was asked for and how it ended, how often.
    pub outcomes: Rc<RefCell<BTreeMap<String, u64>>>,
    /// When a drive was last without power.
    pub without_power: Times,
    /// When its processor last stood still.
    pub stood: Times,
}

impl Common {
    pub fn count(&self, what: impl Into<String>) {
        *self.outcomes.borrow_mut().entry(what.into()).or_default() += 1;
    }

    /// Its outcome, which must come in time.
    pub async fn in_time<T>(
        &self,
        what: &str,
        limit: Duration,
        future: impl Future<Output = T>,
    ) -> T {
        let begun = self.clock.now();
        let Some(value) = self.clock.within(limit, future).await else {
            panic!("{what}, begun at {begun:?}, has no end within {limit:?}");
        };
        value
    }

    pub async fn pause(&self, random: &mut Random, most_ms: u64) {
        let time = MS * random.below(most_ms + 1) as u32;
        self.clock.sleep(time).await;
    }
}

/// Moves an axis, stops it, and gets it going again.
pub async fn operator(common: Common, axis: Axis, place: AxisPlace) {
    let mut random = Random::new(common.seed ^ ((place.0 * 4 + place.1) as u64 * 0x1_0000_0001));
    let mut number = 0;
    while !common.ending.get() {
        common.pause(&mut random, 80).await;
        let failed = match random.below(12) {
            0 => common
                .in_time("disable", COMMAND_LIMIT, axis.disable())
                .await
                .err(),
            1 => common
                .in_time("stop", COMMAND_LIMIT, axis.stop())
                .await
                .err(),
            2 => common
                .in_time("quick stop", COMMAND_LIMIT, axis.quick_stop())
                .await
                .err(),
            3 => common
                .in_time("reset", COMMAND_LIMIT, axis.reset_fault())
                .await
                .err(),
            4 => {
                axis.stop_handle().halt();
                common.pause(&mut random, 50).await;
                common
                    .in_time("resume", COMMAND_LIMIT, axis.resume())
                    .await
                    .err()
            }
            5..=7 => {
                common.judge.asks_enable(place, common.clock.now());
                common
                    .in_time("enable", COMMAND_LIMIT, axis.enable())
                    .await
                    .err()
            }
            _ => moves(&common, &axis, place, &mut random, &mut number).await,
        };
        if let Some(error) = failed {
            assert_eq!(error.identity.axis, axis.identity().axis, "{error}");
            common.count(format!("axis: {}", variant(&error.kind)));
            if let Some(Failure::Fault { .. }) = error.failure() {
                let reset = axis.reset_fault();
                let _ = common.in_time("reset", COMMAND_LIMIT, reset).await;
            }
        } else {
            common.count("axis: ok");
        }
    }
}

async fn moves(
    common: &Common,
    axis: &Axis,
    place: AxisPlace,
    random: &mut Random,
    number: &mut i32,
) -> Option<servocrab::AxisError> {
    let mode = common.in_time("the mode", COMMAND_LIMIT, axis.profile_position());
    let mode = match mode.await {
        Ok(mode) => mode,
        Err(error) => return Some(error),
    };
    for _ in 0..random.between(1, 3) {
        *number += 1;
        let target = (random.below(200) as i32 - 100) * 1_000 + *number;
        let starts = [BufferMode::Aborting, BufferMode::Buffered];
        let set_point = SetPoint::new()
            .velocity(random.between(10_000, 200_000) as u32)
            .acceleration(1_000_000)
            .deceleration(1_000_000)
            .buffer_mode(random.one_of(&starts));
        let asked_at = common.clock.now();
        common.judge.asks_move(place, asked_at, target);
        let moved = mode.move_abs(target, set_point);
        let motion = match common.in_time("a move", COMMAND_LIMIT, moved).await {
            Ok(motion) => motion,
            Err(error) => return Some(error),
        };
        common.count("move: accepted");
        // Of a drive whose processor stands nobody can tell: docs/decisions/0005.
        let stood = common.stood.borrow().get(&place.0).copied();
        if common.honest && stood.is_none_or(|at| at < asked_at) {
            let executed = common.judge.executed(place, target);
            assert_eq!(executed, 1, "the drive has taken the move to {target}");
        }
        if random.once_in(3) {
            let patience = MS * random.between(1, 2_000) as u32;
            if let Some(Err(error)) = common.clock.within(patience, motion.done()).await {
                return Some(error);
            }
        } else {
            common.pause(random, 300).await;
        }
    }
    None
}

/// Looks after the devices: whoever is out is led back, sooner or later.
pub async fn keeper(common: Common, net: &Network, declared: Vec<u16>) {
    let mut random = Random::new(common.seed ^ 0x6B65_6570);
    let events = net.events();
    while !common.ending.get() {
        common.pause(&mut random, 40).await;
        let event = events.try_next();
        let at = match &event {
            Some(NetworkEvent::LeftOp { drive, .. } | NetworkEvent::Back(drive)) => drive.position,
            _ if random.once_in(20) => random.one_of(&declared),
            _ => continue,
        };
        recover(&common, net, at, &mut random).await;
    }
}

async fn recover(common: &Common, net: &Network, position: u16, random: &mut Random) {
    if random.once_in(5) {
        let patience = MS * random.below(200) as u32;
        common.clock.within(patience, net.recover(position)).await;
        common.count("recover: dropped");
        return;
    }
    let recovered = net.recover(position);
    let recovered = common.in_time("a way back", RECOVER_LIMIT, recovered).await;
    match recovered {
        Ok(recovered) => common.count(format!("recover: {}", variant(&recovered))),
        Err(error) => {
            tells_where(&error, Some(position));
            common.count(format!("recover: {}", variant(&error)));
        }
    }
}

/// Asks what else can be asked.
pub async fn inspector(common: Common, net: &Network, axes: Vec<String>) {
    let mut random = Random::new(common.seed ^ 0x696E_7370);
    while !common.ending.get() {
        common.pause(&mut random, 200).await;
        if random.once_in(2) {
            let ports = common.in_time("the ports", SDO_LIMIT, net.port_errors());
            common.count(if ports.await.is_ok() {
                "ports: ok"
            } else {
                "ports: error"
            });
        } else if !axes.is_empty() {
            let name = &axes[random.below(axes.len() as u64) as usize];
            let black_box = common.in_time("a black box", SDO_LIMIT, net.black_box(name));
            black_box.await.unwrap();
            common.count("black box: ok");
        }
    }
}

/// An error of the bus tells the drive and the step, or that it is about the line.
pub fn tells_where(error: &NetworkError, position: Option<u16>) {
    match error {
        NetworkError::Drive { drive, .. } => {
            assert!(
                position.is_none_or(|position| position == drive.position),
                "{error}"
            );
        }
        NetworkError::WrongLine(_)
        | NetworkError::Line(_)
        | NetworkError::NoAnswer
        | NetworkError::NoSubDevice
        | NetworkError::TooManySubDevices { .. }
        | NetworkError::NotLocked { .. } => {}
        other => panic!("this tells nobody what to do: {other}"),
    }
}

/// The first word of what Debug makes of it.
pub fn variant(of: &impl std::fmt::Debug) -> String {
    let text = format!("{of:?}");
    let end = |text: &str| text.find([' ', '(', '{']).unwrap_or(text.len());
    let first = &text[..end(&text)];
    let rest = text[end(&text)..].trim_start_matches('(');
    match first {
        "Failed" | "Sdo" => format!("{first}({})", &rest[..end(rest)]),
        _ => first.to_owned(),
    }
}
