//! A scenario: a line is brought up, works, has faults, is brought back into OP, and ends.

use std::{
    collections::BTreeMap,
    future::Future,
    pin::pin,
    task::{Context, Poll, Waker},
    time::Duration,
};

use servocrab::{
    BufferMode, Network, NetworkError, Outcome, SetPoint,
    bus::{BusLoop, NetworkBuilder},
    coe::obj,
    drives,
};
use servocrab_sim::{AlState, Segment, ds402::Plant, ds402::State, personality};

use crate::{
    cable::{Cable, Wired},
    clerks::{self, Desk},
    faults_of_line::{FaultDriver, faults},
    judge::Judge,
    line::{Member, member},
    program::{self, Common, MS, RECOVER_LIMIT, SDO_LIMIT, tells_where, variant},
    random::Random,
    tasks::{Clock, Tasks},
};

/// Longer than any bring-up, well or not.
const START_LIMIT: Duration = Duration::from_secs(60);
/// Longer than any end: 15 s for axes that stop, a second for each state.
const END_LIMIT: Duration = Duration::from_secs(40);

/// No answer is later than that.
const LATE: Duration = Duration::from_millis(1_500);

struct Scenario {
    random: Random,
    wired: Wired,
    members: Vec<Member>,
    cycle: Duration,
    common: Common,
    /// Drives by their position.
    drives: BTreeMap<usize, usize>,
}

/// What happened in it, how often.
pub type Story = BTreeMap<String, u64>;

/// Runs one scenario.
pub fn live(seed: u64) -> Result<Story, String> {
    let mut scenario = Scenario::new(seed);
    if std::env::var("LINE_LOG").is_ok() {
        eprintln!("{:?} each {:?}", scenario.wired.line(), scenario.cycle);
    }
    let mut faults_of_line = FaultDriver::new(
        seed,
        &scenario.wired,
        scenario.drives.clone(),
        &scenario.common,
    );
    // Of half of the scenarios the begin is hard too.
    let hard = scenario.random.once_in(2);
    let mut begun = scenario.start(hard.then_some(&mut faults_of_line));
    if let Err(error) = &begun {
        tells_where(error, None);
        scenario.common.count(format!("start: {}", variant(error)));
        faults_of_line.end(scenario.now());
        begun = scenario.start(None);
    }
    let (net, mut bus) = begun.map_err(|error| format!("on a healthy line: {error}"))?;
    scenario.common.count("start: ok");
    let works = scenario.works(&net, &mut bus, &mut faults_of_line);
    works.and_then(|()| scenario.is_well_again(&net, &mut bus))?;
    scenario.ends(&net, bus)?;
    scenario.common.judge.verdict()?;
    scenario.writes_are_made_once()?;
    let mut story = scenario.common.outcomes.take();
    let line = scenario.wired.line();
    let cable = line.seen().iter();
    story.extend(cable.map(|(what, times)| (format!("cable: {what}"), *times)));
    let devices = faults_of_line.seen.iter();
    story.extend(devices.map(|(what, times)| (format!("device: {what}"), *times)));
    let now = scenario.wired.now().as_millis() as u64;
    story.insert("milliseconds".to_owned(), now);
    Ok(story)
}

impl Scenario {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut segment = Segment::new();
        let (mut members, mut drives) = (Vec::new(), BTreeMap::new());
        for position in 0..random.between(1, 4) as usize {
            let (device, member) = member(&mut random, position);
            if matches!(member, Member::Drive(..)) {
                drives.insert(position, drives.len());
            }
            segment.push(device);
            members.push(member);
        }
        if drives.is_empty() {
            drives.insert(members.len(), 0);
            let axis = format!("{}.0", members.len());
            members.push(Member::Drive(Box::new(drives::generic()), vec![axis]));
            segment.push(personality::generic());
        }
        segment.set_plant(Plant::seeded(seed));
        let judge = Judge::on(&mut segment);
        let wired = Wired::new(segment, &faults(&mut random, seed));
        let honest = !wired.lies;
        Self {
            cycle: random.one_of(&[MS / 2, MS, MS * 2]),
            random,
            wired,
            members,
            common: Common {
                clock: Clock::default(),
                judge,
                seed,
                honest,
                ending: std::rc::Rc::default(),
                outcomes: std::rc::Rc::default(),
                without_power: std::rc::Rc::default(),
                stood: std::rc::Rc::default(),
            },
            drives,
        }
    }

    fn now(&self) -> Duration {
        self.wired.now()
    }

    fn builder(&self) -> NetworkBuilder {
        let cable = Cable::new(&self.wired);
        let mut builder = Network::builder().link(cable).cycle(self.cycle);
        builder = builder.complete();
        for (position, member) in (0..).zip(&self.members) {
            builder = member.declared(builder, position);
        }
        builder
    }

    fn start(
        &mut self,
        mut faults_of_line: Option<&mut FaultDriver>,
    ) -> Result<(Network, BusLoop), NetworkError> {
        let (starting, mut bus) = self.builder().split()?;
        let clock = self.common.clock.clone();
        let (judge, wired) = (self.common.judge.clone(), self.wired.clone());
        let started = turn(&mut bus, START_LIMIT, starting.network(), |now| {
            clock.set(now);
            judge.look(wired.line().segment(), now);
            if let Some(faults_of_line) = faults_of_line.as_deref_mut() {
                faults_of_line.act(now);
            }
        });
        let net = started.ok_or_else(|| NetworkError::Declaration("no end".into()))??;
        Ok((net, bus))
    }

    /// The network works while there is trouble.
    fn works(
        &mut self,
        net: &Network,
        bus: &mut BusLoop,
        faults_of_line: &mut FaultDriver,
    ) -> Result<(), String> {
        let common = &self.common;
        let mut tasks = Tasks::default();
        let mut names = Vec::new();
        for (position, member) in self.members.iter().enumerate() {
            let Member::Drive(_, axes) = member else {
                continue;
            };
            let desk = self.desk(net, position);
            for number in 0..2 {
                let clerk = clerks::clerk(common.clone(), desk.clone(), number);
                tasks.spawn(format!("clerk {number} of {position}"), clerk);
            }
            if desk.has_note {
                let writer = clerks::writer(common.clone(), desk.clone());
                tasks.spawn(format!("writer of {position}"), writer);
            }
            for (number, name) in axes.iter().enumerate() {
                let axis = net.axis(name).unwrap();
                let operator = program::operator(common.clone(), axis, (desk.drive, number));
                tasks.spawn(format!("operator of {name}"), operator);
                names.push(name.clone());
            }
        }
        let members = (0..).zip(&self.members);
        let declared = members.filter(|(_, member)| !matches!(member, Member::Other(_)));
        let declared = declared.map(|(position, _)| position).collect();
        tasks.spawn("keeper", program::keeper(common.clone(), net, declared));
        tasks.spawn("inspector", program::inspector(common.clone(), net, names));
        let end = bus.now() + MS * self.random.between(300, 4_000) as u32;
        let mut over = None;
        loop {
            common.clock.set(bus.now());
            tasks.poll();
            if !bus.turn() {
                return Err("the loop has ended".into());
            }
            let now = bus.now();
            common.judge.look(self.wired.line().segment(), now);
            match over {
                None if now >= end => {
                    faults_of_line.end(now);
                    common.ending.set(true);
                    over = Some(now + RECOVER_LIMIT + SDO_LIMIT);
                }
                None => faults_of_line.act(now),
                Some(_) if tasks.are_over() => return Ok(()),
                Some(limit) if now >= limit => {
                    return Err(format!("these have no end: {:?}", tasks.names()));
                }
                Some(_) => {}
            }
        }
    }

    fn desk(&self, net: &Network, position: usize) -> Desk {
        let line = self.wired.line();
        let description = line.segment().device(position).unwrap().description();
        let identity = description.identity;
        let position = position as u16;
        Desk {
            sdo: net.sdo(position).unwrap(),
            position,
            drive: self.drives[&usize::from(position)],
            product: identity.product,
            name: description.name.clone(),
            has_note: [personality::akd2g(), personality::generic()]
                .iter()
                .any(|device| device.description().identity.product == identity.product),
        }
    }

    /// Each device can be led back, is spoken with, and moves.
    fn is_well_again(&mut self, net: &Network, bus: &mut BusLoop) -> Result<(), String> {
        let clock = self.common.clock.clone();
        let (judge, wired) = (self.common.judge.clone(), self.wired.clone());
        let each = |now| {
            clock.set(now);
            judge.look(wired.line().segment(), now);
        };
        let mut until =
            |what: String,
             future: std::pin::Pin<Box<dyn Future<Output = Result<(), String>> + '_>>| {
                turn(bus, RECOVER_LIMIT, future, each)
                    .ok_or_else(|| format!("{what}: no end"))?
                    .map_err(|error| format!("{what}: {error}"))
            };
        // What was taken before may be answered late still.
        let late = async {
            clock.sleep(LATE).await;
            Ok(())
        };
        until("some time".into(), Box::pin(late))?;
        let members = self.members.iter().enumerate();
        for (position, _) in members.filter(|(_, member)| !matches!(member, Member::Other(_))) {
            let what = format!("the way back of {position} on a healthy line");
            let recovered = async move {
                let recovered = net.recover(position as u16).await;
                recovered.map(drop).map_err(|error| error.to_string())
            };
            until(what, Box::pin(recovered))?;
        }
        for (position, member) in self.members.iter().enumerate() {
            let Member::Drive(_, axes) = member else {
                continue;
            };
            let desk = self.desk(net, position);
            let reads = async move {
                // As many at once as there are places, and more.
                for _ in 0..3 {
                    let reads = (0..24).map(|_| desk.sdo.read(obj::PRODUCT_CODE));
                    let mut reads: Vec<_> = reads.map(Box::pin).collect();
                    for read in &mut reads {
                        let read = read.await.map_err(|error| error.to_string())?;
                        if read != desk.product {
                            return Err(format!("it is {read:08X}"));
                        }
                    }
                }
                Ok(())
            };
            until(format!("reading of {position}"), Box::pin(reads))?;
            for (number, name) in axes.iter().enumerate() {
                let place = (self.drives[&position], number);
                let (axis, common) = (net.axis(name).unwrap(), self.common.clone());
                let moves = async move {
                    moves_once(&axis, &common, place)
                        .await
                        .map_err(|error| error.to_string())
                };
                until(format!("the last move of {name}"), Box::pin(moves))?;
            }
        }
        Ok(())
    }

    /// The end in order: the axes are switched off, all devices in INIT.
    fn ends(&mut self, net: &Network, mut bus: BusLoop) -> Result<(), String> {
        let clock = self.common.clock.clone();
        let over = turn(&mut bus, END_LIMIT, net.shutdown(), |now| clock.set(now));
        // Which axes it did not see at standstill, of drives that were cut off, is not asked here.
        let _ = over.ok_or("the end has no end")?;
        let mut line = self.wired.line();
        line.advance(self.wired.now() + 50 * MS);
        let segment = line.segment();
        for (position, device) in segment.devices().iter().enumerate() {
            if device.al_state() != AlState::Init {
                return Err(format!(
                    "{position} is in {:?} at the end",
                    device.al_state()
                ));
            }
            if device
                .axes()
                .iter()
                .any(|axis| axis.state() == State::OperationEnabled)
            {
                return Err(format!("{position} is enabled at the end"));
            }
        }
        Ok(())
    }

    /// Each value was written once at most, as far as the devices' answers let anybody know.
    fn writes_are_made_once(&self) -> Result<(), String> {
        let lies = [
            "mail-other",
            "mail-emergency",
            "mail-garbage",
            "mail-bits",
            "flip-data",
        ];
        let line = self.wired.line();
        if lies.iter().any(|lie| line.seen().contains_key(lie)) {
            return Ok(());
        }
        for ((station, object, value), times) in &self.wired.messages().written {
            if object.0 == crate::judge::WRITTEN && *times > 1 && *value >= 1_100_000 {
                return Err(format!(
                    "{value} was written {times} times to {object:04X?} of {station:04X}h"
                ));
            }
        }
        Ok(())
    }
}

async fn moves_once(
    axis: &servocrab::Axis,
    common: &Common,
    place: crate::judge::AxisPlace,
) -> Result<(), Box<dyn std::error::Error>> {
    axis.stop().await?;
    if axis.status().state.is_fault() {
        axis.reset_fault().await?;
    }
    common.judge.asks_enable(place, common.clock.now());
    axis.enable().await?;
    axis.resume().await?;
    let mode = axis.profile_position().await?;
    let target = axis.status().position + 1_234;
    common.judge.asks_move(place, common.clock.now(), target);
    let set_point = SetPoint::new()
        .velocity(50_000)
        .acceleration(1_000_000)
        .deceleration(1_000_000)
        .buffer_mode(BufferMode::Buffered);
    let motion = mode.move_abs(target, set_point).await?;
    match motion.done().await? {
        Outcome::Reached { .. } => Ok(()),
        other => Err(format!("{other:?}").into()),
    }
}

/// Turns the loop until the future is ready; `None` if that takes longer than `limit`.
fn turn<T>(
    bus: &mut BusLoop,
    limit: Duration,
    future: impl Future<Output = T>,
    mut each: impl FnMut(Duration),
) -> Option<T> {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    let end = bus.now() + limit;
    let mut goes_on = true;
    loop {
        each(bus.now());
        if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
            return Some(value);
        }
        if !goes_on || bus.now() > end {
            return None;
        }
        goes_on = bus.turn();
    }
}
