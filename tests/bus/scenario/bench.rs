//! One drive on a network in virtual time, and what was asked of it.

use std::{
    cell::Cell,
    future::{Future, poll_fn},
    pin::Pin,
    rc::Rc,
    sync::Arc,
    task::Context,
    task::Poll,
    task::Waker,
    time::Duration,
};

use servocrab::{
    Axis, AxisConfig, AxisError, BufferMode, DriveConfig, Failure, HomingMethod, HomingParameters,
    Move, Network, Outcome, ProfilePosition, Referencing, SetPoint,
    axis::{AxisErrorKind, Unsupported},
    coe::{SdoError, obj},
    drives::DriveDescription,
    ds402::State,
};
use servocrab_sim::{
    Segment,
    ds402::{Executed, Machine},
    personality::Servo,
};

use crate::rig::{Line, Rig};

/// Where the shaft's negative limit switch is, in counts from where it stands at power-up.
pub(crate) const SWITCH: i32 = -100_000;
pub(crate) const MS: Duration = Duration::from_millis(1);

/// A drive: the simulated device, and the library's description of it.
pub(crate) struct Subject {
    pub(crate) name: &'static str,
    pub(crate) device: fn() -> Servo,
    pub(crate) description: fn() -> DriveDescription,
    pub(crate) referencing: Referencing,
    /// Whether it has mode 3, so that 60FFh can be mapped.
    pub(crate) jogs: bool,
}

type Asked = Pin<Box<dyn Future<Output = String>>>;

pub(crate) struct Bench {
    rig: Rig,
    line: Line,
    pub(crate) axis: Axis,
    mode: Option<Arc<ProfilePosition>>,
    asked: Vec<(Option<String>, Asked)>,
    /// The time, for what is asked.
    clock: Rc<Cell<Duration>>,
    /// Set-points in the ledger before the step.
    executed: usize,
}

impl Bench {
    pub(crate) fn start(subject: &Subject) -> Self {
        let shaft = Machine {
            negative_limit: Some(SWITCH.into()),
            ..Machine::default()
        };
        let servo = (subject.device)().change(move |drive| drive.machine = shaft.clone());
        let line = Line::new(Segment::new().with(servo.build()));
        let drive = DriveConfig::new((subject.description)())
            .axis(AxisConfig::new("x").referencing(subject.referencing));
        let drive = if subject.jogs {
            drive.change_axis("x", |axis| axis.map_output(obj::TARGET_VELOCITY))
        } else {
            drive
        };
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive)).unwrap();
        let axis = rig.net().axis("x").unwrap();
        rig.run_for(20 * MS);
        Self {
            rig,
            line,
            axis,
            mode: None,
            asked: Vec::new(),
            clock: Rc::default(),
            executed: 0,
        }
    }

    /// Enabled and standing, whatever was before.
    pub(crate) fn make_ready(&mut self) {
        self.mode = None;
        let axis = self.axis.clone();
        self.rig.until(async {
            axis.disable().await.unwrap();
            if axis.status().state == State::Fault {
                axis.reset_fault().await.unwrap();
            }
            axis.enable().await.unwrap();
        });
        self.executed = self.ledger().len();
    }

    pub(crate) fn ledger(&self) -> Vec<Executed> {
        let segment = self.line.segment();
        segment.axis(0, 0).unwrap().ledger().to_vec()
    }

    /// What was executed in this step: targets, in order.
    pub(crate) fn executed(&self) -> String {
        let ledger = self.ledger();
        let targets: Vec<_> = ledger[self.executed..]
            .iter()
            .map(|e| match e.target {
                None => "?".to_owned(),
                // It may count from where the shaft is.
                Some(target) if e.relative => (target + 50)
                    .div_euclid(100)
                    .saturating_mul(100)
                    .to_string(),
                Some(target) => target.to_string(),
            })
            .collect();
        targets.join(" ")
    }

    pub(crate) fn position(&self) -> i64 {
        self.line.segment().axis(0, 0).unwrap().position()
    }

    pub(crate) fn fault(&mut self, code: u16) {
        self.line
            .segment()
            .axis_mut(0, 0)
            .unwrap()
            .inject_fault(code);
    }

    pub(crate) fn mode(&mut self) -> Arc<ProfilePosition> {
        if self.mode.is_none() {
            let axis = self.axis.clone();
            self.mode = Some(Arc::new(self.rig.until(axis.profile_position()).unwrap()));
        }
        Arc::clone(self.mode.as_ref().unwrap())
    }

    /// Asks for a move to a position and goes on.
    pub(crate) fn abs(&mut self, target: i32, set_point: SetPoint) {
        let mode = self.mode();
        self.ask(async move { end_of(mode.move_abs(target, set_point).await).await });
    }

    /// Asks for a move by a distance and goes on.
    pub(crate) fn rel(&mut self, distance: i32, set_point: SetPoint) {
        let mode = self.mode();
        self.ask(async move { end_of(mode.move_rel(distance, set_point).await).await });
    }

    /// Asks for a homing, with 607Ch = `offset`, and goes on.
    pub(crate) fn home(&mut self, method: HomingMethod, offset: i32) {
        self.mode = None;
        let axis = self.axis.clone();
        self.ask(async move {
            let homing = match axis.homing().await {
                Ok(homing) => homing,
                Err(error) => return format!("not selected: {}", in_words(&error)),
            };
            let parameters = HomingParameters::new(method)
                .speeds(50_000, 5_000)
                .acceleration(500_000)
                .offset(offset);
            match homing.home(parameters).await {
                Ok(homed) => format!("homed at {}", rounded(homed.position)),
                Err(error) => in_words(&error),
            }
        });
    }

    /// Writes 607Dh and has the axis read it.
    pub(crate) fn set_software_limits(&mut self, min: i32, max: i32) {
        let sdo = self.rig.net().sdo(0).unwrap();
        let axis = self.axis.clone();
        self.ask(async move {
            let written = async {
                sdo.write(obj::SOFTWARE_LIMIT_MIN, min).await?;
                sdo.write(obj::SOFTWARE_LIMIT_MAX, max).await
            };
            if let Err(error) = written.await {
                return sdo_in_words(&error.error);
            }
            match axis.read_limits().await {
                Ok(_) => "limits read".to_owned(),
                Err(error) => in_words(&error),
            }
        });
        self.run(100);
    }

    /// Asks for a jog that is held for some milliseconds, and goes on.
    pub(crate) fn jog(&mut self, velocity: i32, milliseconds: u32) {
        self.mode = None;
        let axis = self.axis.clone();
        let end = self.rig.bus.now() + milliseconds * MS;
        let clock = Rc::clone(&self.clock);
        self.ask(async move {
            let mode = match axis.profile_velocity().await {
                Ok(mode) => mode,
                Err(error) => return format!("not selected: {}", in_words(&error)),
            };
            let jog = match mode.jog(velocity).await {
                Ok(jog) => jog,
                Err(error) => return format!("not begun: {}", in_words(&error)),
            };
            poll_fn(|_| {
                if clock.get() < end {
                    Poll::Pending
                } else {
                    Poll::Ready(())
                }
            })
            .await;
            let ended = jog.ended();
            match (ended, jog.release().await) {
                (None, Ok(())) => "jogged".to_owned(),
                (Some(failure), _) => format!("{failure:?}"),
                (None, Err(error)) => in_words(&error),
            }
        });
    }

    /// Asks for something of the axis and goes on.
    pub(crate) fn axis<F, T>(&mut self, ask: impl FnOnce(Axis) -> F)
    where
        F: Future<Output = Result<T, AxisError>> + 'static,
        T: std::fmt::Debug,
    {
        let answer = ask(self.axis.clone());
        self.ask(async move {
            match answer.await {
                Ok(value) => format!("{value:?}").replace("()", "ok"),
                Err(error) => in_words(&error),
            }
        });
    }

    pub(crate) fn ask(&mut self, asked: impl Future<Output = String> + 'static) {
        self.asked.push((None, Box::pin(asked)));
        self.run(0);
    }

    /// Runs for some milliseconds.
    pub(crate) fn run(&mut self, milliseconds: u32) {
        let end = self.rig.bus.now() + milliseconds * MS;
        self.poll();
        while self.rig.bus.now() < end {
            assert!(self.rig.bus.turn(), "the loop has ended");
            self.poll();
        }
    }

    /// Runs until everything that was asked for is answered, and tells the answers in the order of the questions, what
    /// was executed, and where the axis is then.
    pub(crate) fn finish(&mut self) -> String {
        let end = self.rig.bus.now() + 60_000 * MS;
        self.poll();
        while self.asked.iter().any(|(answer, _)| answer.is_none()) {
            assert!(self.rig.bus.turn(), "the loop has ended");
            self.poll();
            let open: Vec<_> = self.asked.iter().map(|(answer, _)| answer).collect();
            assert!(self.rig.bus.now() < end, "without an answer: {open:?}");
        }
        let answers: Vec<_> = self
            .asked
            .drain(..)
            .filter_map(|(answer, _)| answer)
            .collect();
        // Nothing moves any more, and nothing moves afterwards.
        let stood = self.position();
        self.run(300);
        // Loads push the shaft by less than that.
        let moved = (self.position() - stood).abs();
        assert!(moved <= 10, "it moves after the end: {answers:?}");
        let state = self.axis.status().state;
        format!(
            "{}; executed [{}], at {} in {state:?}",
            answers.join("; "),
            self.executed(),
            (stood + 500).div_euclid(1_000) * 1_000,
        )
    }

    pub(crate) fn shutdown(self) {
        self.rig.shutdown();
    }

    fn poll(&mut self) {
        self.clock.set(self.rig.bus.now());
        let mut context = Context::from_waker(Waker::noop());
        for (answer, asked) in &mut self.asked {
            if answer.is_none()
                && let Poll::Ready(text) = asked.as_mut().poll(&mut context)
            {
                *answer = Some(text);
            }
        }
    }
}

/// How every move is made: short ramps.
pub(crate) fn start(buffer_mode: BufferMode) -> SetPoint {
    SetPoint::new()
        .velocity(50_000)
        .acceleration(500_000)
        .deceleration(500_000)
        .buffer_mode(buffer_mode)
}

async fn end_of(accepted: Result<Move, AxisError>) -> String {
    let moved = match accepted {
        Ok(moved) => moved,
        Err(error) => return format!("not accepted: {}", in_words(&error)),
    };
    match moved.done_through_halt().await {
        Ok(Outcome::Reached { position }) => format!("reached {}", rounded(position)),
        Ok(Outcome::Passed { position }) => format!("passed {}", rounded(position)),
        Ok(other) => panic!("no words for {other}"),
        Err(error) => in_words(&error),
    }
}

/// To the nearest hundred: the window is not the subject here.
fn rounded(position: i32) -> i32 {
    (position + 50).div_euclid(100) * 100
}

fn in_words(error: &AxisError) -> String {
    match &error.kind {
        AxisErrorKind::HomingMethod { method, .. } => format!("no {method:?}"),
        AxisErrorKind::Failed(Failure::Timeout { waiting_for, .. }) => {
            format!("Timeout {waiting_for:?}")
        }
        AxisErrorKind::Failed(Failure::Unsupported(Unsupported::Start { buffer_mode, .. })) => {
            format!("Unsupported {buffer_mode:?}")
        }
        AxisErrorKind::Failed(Failure::Fault { code, .. }) => {
            format!("Fault {:04X}h", code.unwrap_or(0))
        }
        AxisErrorKind::Failed(Failure::Unsupported(Unsupported::ProfileType {
            profile_type,
            ..
        })) => {
            format!("ProfileType {profile_type}")
        }
        AxisErrorKind::Failed(Failure::BeyondLimit { object, limit, .. }) => {
            format!("BeyondLimit {object} at {limit}")
        }
        AxisErrorKind::Failed(failure) => format!("{failure:?}"),
        AxisErrorKind::Sdo(error) => sdo_in_words(error),
        other => format!("{other:?}"),
    }
}

fn sdo_in_words(error: &SdoError) -> String {
    match error {
        SdoError::Aborted { transfer, code } => {
            format!("{} aborted, {:08X}h", transfer.object, code.0)
        }
        other => format!("{other:?}"),
    }
}
