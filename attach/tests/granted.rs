//! What clients may do where the program grants it, over the sockets of a running, simulated machine.
#![allow(missing_docs)]

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    os::unix::net::UnixStream,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use servocrab::{
    Axis, AxisConfig, DriveConfig, Network, Referencing,
    bus::Signal,
    coe::{AbortCode, SdoError, obj},
    drives,
    ds402::State,
    link::Wire,
    units::{Mm, Ratio, Scale},
};
use servocrab_attach::{
    AskedFor, Attach, AttachError, Attached, Grant, Program, Watch, forward, serve,
};
use servocrab_sim::{Segment, personality};
use tempfile::TempDir;
use tungstenite::{
    Message, WebSocket,
    client::{IntoClientRequest, client_with_config},
    handshake::client::Request,
};

const TIME: Duration = Duration::from_secs(20);

/// Two axes, of which 1000 counts are one millimetre.
fn machine() -> (Network, Arc<Mutex<Segment>>) {
    machine_of(|axis| axis)
}

/// Axes that are more than these.
fn machine_of(config: impl Fn(AxisConfig) -> AxisConfig) -> (Network, Arc<Mutex<Segment>>) {
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::akd2g())));
    let wired = Arc::clone(&segment);
    let wire = Wire::new(move |frame, now| wired.lock().unwrap().process(frame, now));
    let axis = |name: &str| {
        let scale = Scale::counts_per_unit(Ratio::new(1000, 1).unwrap());
        AxisConfig::new(name)
            .unit::<Mm>(scale)
            .referencing(Referencing::AbsoluteEncoder)
            .map_output(obj::TARGET_VELOCITY)
    };
    let drive = DriveConfig::new(drives::akd2g())
        .axis(config(axis("x")))
        .axis(config(axis("y")));
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(2))
        .watchdog(Duration::from_secs(5))
        .drive(0, drive);
    (smol::block_on(builder.start()).unwrap(), segment)
}

fn shown(net: &Network, grants: &[Grant]) -> (TempDir, Attached) {
    let runtime = tempfile::tempdir().unwrap();
    let attach = Attach::new("sim0")
        .directory(runtime.path().join("servocrab"))
        .loopback(0);
    let attach = grants.iter().cloned().fold(attach, Attach::grant);
    let attached = serve(net, attach).unwrap();
    (runtime, attached)
}

fn jog() -> Grant {
    Grant::Jog {
        axes: vec!["x".into()],
        max_velocity: 20.0,
    }
}

fn motion() -> Grant {
    Grant::Motion {
        axes: vec!["x".into()],
    }
}

/// The address and the token of a panel.
fn address(panel: &str) -> (SocketAddr, String) {
    let (address, token) = panel
        .strip_prefix("http://")
        .unwrap()
        .split_once("/#token=")
        .unwrap();
    (address.parse().unwrap(), token.to_owned())
}

fn exchange(mut stream: impl Read + Write, request: &str) -> (u16, String) {
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head[9..12].parse().unwrap(), body.to_owned())
}

/// The status and the JSON of the answer on the Unix socket.
fn ask(attached: &Attached, request: &str, body: &str) -> (u16, Value) {
    let stream = UnixStream::connect(attached.socket()).unwrap();
    stream.set_read_timeout(Some(TIME)).unwrap();
    let length = body.len();
    let request = format!(
        "{request} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n{body}"
    );
    let (status, body) = exchange(stream, &request);
    (status, serde_json::from_str(&body).unwrap())
}

fn code(answer: &Value) -> &str {
    answer["error"]["code"].as_str().unwrap()
}

type Socket = WebSocket<UnixStream>;

fn websocket(attached: &Attached, path: &str) -> Socket {
    let stream = UnixStream::connect(attached.socket()).unwrap();
    stream.set_read_timeout(Some(TIME)).unwrap();
    let request = format!("ws://localhost{path}")
        .into_client_request()
        .unwrap();
    client_with_config(request, stream, None).unwrap().0
}

fn said(socket: &mut WebSocket<impl Read + Write>) -> Value {
    loop {
        if let Message::Text(text) = socket.read().unwrap() {
            return serde_json::from_str(&text).unwrap();
        }
    }
}

/// The next message that is no tick.
fn answered(socket: &mut Socket) -> Value {
    loop {
        let message = said(socket);
        if message.get("tick").is_none() {
            return message;
        }
    }
}

/// The next tick, and none that has waited here.
fn tick(socket: &mut Socket) -> u64 {
    loop {
        let asked = Instant::now();
        if let Some(tick) = said(socket).get("tick")
            && asked.elapsed() > Duration::from_millis(5)
        {
            return tick.as_u64().unwrap();
        }
    }
}

fn hold(socket: &mut Socket, axis: &str, velocity: f64, tick: u64) {
    let hold = json!({"hold": {"axis": axis, "velocity": velocity, "tick": tick}});
    socket.send(Message::text(hold.to_string())).unwrap();
}

/// Holds a jog of `x` until it moves as fast as is asked, which the server says.
fn begun(net: &Network, socket: &mut Socket, velocity: f64) {
    let x = net.axis_in::<Mm>("x").unwrap();
    let (started, mut is_told) = (Instant::now(), false);
    while !is_told || (x.status().velocity - velocity).abs() > 1.0 {
        let message = said(socket);
        if let Some(tick) = message.get("tick") {
            hold(socket, "x", velocity, tick.as_u64().unwrap());
        } else {
            assert_eq!(message, json!({"jog": {"axis": "x", "state": "moving"}}));
            is_told = true;
        }
        assert!(started.elapsed() < TIME, "{:?}", x.status());
    }
}

/// Whether `x` comes to a stand by itself.
fn stands(net: &Network) -> bool {
    let position = || i64::from(net.axis("x").unwrap().status().position);
    let started = Instant::now();
    let (mut before, mut same) = (position(), 0);
    while started.elapsed() < TIME && same < 10 {
        std::thread::sleep(Duration::from_millis(10));
        let now = position();
        same = if (now - before).abs() < 20 {
            same + 1
        } else {
            0
        };
        before = now;
    }
    same == 10
}

fn enabled(net: &Network) -> Axis {
    let x = net.axis("x").unwrap();
    smol::block_on(x.enable()).unwrap();
    x
}

#[test]
fn a_held_jog_moves_and_each_way_of_letting_go_ends_it() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[jog()]);
    // The end of the program's last handle would stop the axis.
    let _kept = enabled(&net);
    let mut socket = websocket(&attached, "/v1/control");

    begun(&net, &mut socket, 10.0);
    let release = json!({"release": {"axis": "x"}}).to_string();
    socket.send(Message::text(release)).unwrap();
    assert_eq!(
        answered(&mut socket),
        json!({"jog": {"axis": "x", "state": "released"}})
    );
    assert!(stands(&net));

    // Nobody says that it is held any more, although the connection is there.
    begun(&net, &mut socket, -10.0);
    assert!(stands(&net));
    assert_eq!(answered(&mut socket)["jog"]["state"], "ended");
    // Who still holds it has to let go first.
    let again = tick(&mut socket);
    hold(&mut socket, "x", -10.0, again);
    assert_eq!(code(&answered(&mut socket)), "ended");
    let release = json!({"release": {"axis": "x"}}).to_string();
    socket.send(Message::text(release)).unwrap();

    // The connection is cut.
    begun(&net, &mut socket, 10.0);
    drop(socket);
    assert!(stands(&net));
    // And the mode is free for the program again.
    let x = net.axis("x").unwrap();
    let started = Instant::now();
    while smol::block_on(x.profile_position()).is_err() {
        assert!(started.elapsed() < TIME);
    }
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn holds_that_were_delayed_on_their_way_move_nothing() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[jog()]);
    // The end of the program's last handle would stop the axis.
    let _kept = enabled(&net);
    let mut socket = websocket(&attached, "/v1/control");
    let old = tick(&mut socket);
    // Ticks go on, so that this one is old by more than its time.
    while tick(&mut socket) < old + 300 {}
    for _ in 0..50 {
        hold(&mut socket, "x", 10.0, old);
        assert_eq!(code(&answered(&mut socket)), "late");
    }
    // One from the time to come is none that was sent.
    hold(&mut socket, "x", 10.0, old + 1_000_000);
    assert_eq!(code(&answered(&mut socket)), "late");
    let moved = net.axis("x").unwrap().status();
    assert!(moved.position.abs() < 100, "{moved:?}");
    // A burst that begins to be late in the middle of a jog ends it: what is late feeds nothing.
    begun(&net, &mut socket, 10.0);
    let old = tick(&mut socket);
    for _ in 0..50 {
        hold(&mut socket, "x", 10.0, old);
        tick(&mut socket);
    }
    assert!(stands(&net));
    smol::block_on(net.shutdown()).unwrap();
}

/// The program has no lease that it could give back.
#[test]
fn the_program_is_not_asked_for_an_axis_that_a_client_has() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[jog(), motion()]);
    let x = enabled(&net);
    let mut socket = websocket(&attached, "/v1/control");
    begun(&net, &mut socket, 10.0);
    let (status, refused) = ask(
        &attached,
        "POST /v1/axes/x/home",
        r#"{"method":37,"within":1}"#,
    );
    assert_eq!((status, code(&refused)), (409, "in_use"));
    let text = refused["error"]["text"].as_str().unwrap();
    assert!(text.contains("a client has it"), "{text}");
    drop(socket);
    assert!(stands(&net));
    // What the program holds it is asked for: this is the first question.
    let started = Instant::now();
    let lease = loop {
        match smol::block_on(x.profile_position()) {
            Ok(lease) => break lease,
            Err(error) => assert!(started.elapsed() < TIME, "{error}"),
        }
    };
    let to = r#"{"to":1,"velocity":1}"#;
    assert_eq!(
        code(&ask(&attached, "POST /v1/axes/x/move", to).1),
        "in_use"
    );
    assert!(smol::block_on(attached.asked()).is_some());
    let second = smol::block_on(smol::future::or(
        async { Some(attached.asked().await) },
        async {
            smol::Timer::after(Duration::from_millis(50)).await;
            None
        },
    ));
    assert_eq!(second, None);
    smol::block_on(lease.release()).unwrap();
    smol::block_on(net.shutdown()).unwrap();
}

/// A browser has six requests to a server under way, and a further one waits until one of them is answered.
#[test]
fn a_stop_over_the_control_socket_needs_no_request_no_grant_and_no_tick() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[motion()]);
    let x = enabled(&net);
    for stop in [json!({"stop": {"axis": "x"}}), json!({"quick_stop": {}})] {
        smol::block_on(x.enable()).unwrap();
        let mut socket = websocket(&attached, "/v1/control");
        let by = r#"{"by":60,"velocity":20}"#;
        let moved = std::thread::scope(|scope| {
            let moved = scope.spawn(|| ask(&attached, "POST /v1/axes/x/move", by));
            let started = Instant::now();
            while x.status().velocity == 0 {
                assert!(started.elapsed() < TIME, "{stop}");
                std::thread::sleep(Duration::from_millis(5));
            }
            socket.send(Message::text(stop.to_string())).unwrap();
            assert_eq!(answered(&mut socket), json!({"asked": true}), "{stop}");
            moved.join().unwrap()
        });
        assert_eq!(code(&moved.1), "axis", "{stop}");
        assert!(stands(&net), "{stop}");
    }
    let mut socket = websocket(&attached, "/v1/control");
    let unknown = json!({"stop": {"axis": "z"}}).to_string();
    socket.send(Message::text(unknown)).unwrap();
    assert_eq!(code(&answered(&mut socket)), "no_axis");
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn nothing_is_written_moved_or_enabled_without_a_grant_of_just_that() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[]);
    for (request, body) in [
        ("POST /v1/od/0/3472h/0", r#"{"bytes":[1,0]}"#),
        ("POST /v1/axes/x/enable", ""),
        ("POST /v1/axes/x/disable", ""),
        ("POST /v1/axes/x/reset_fault", ""),
        ("POST /v1/axes/x/recover", ""),
        ("POST /v1/enable", ""),
        ("POST /v1/axes/x/move", r#"{"to":1,"velocity":1}"#),
        ("POST /v1/axes/x/home", r#"{"method":37,"within":1}"#),
    ] {
        let (status, answer) = ask(&attached, request, body);
        assert_eq!((status, code(&answer)), (403, "not_granted"), "{request}");
    }
    let mut socket = websocket(&attached, "/v1/control");
    let now = tick(&mut socket);
    hold(&mut socket, "x", 1.0, now);
    assert_eq!(code(&answered(&mut socket)), "not_granted");
    drop((socket, attached));

    // To jog is not to move, and `x` is not `y`.
    let (_runtime, attached) = shown(&net, &[jog()]);
    let grants = ask(&attached, "GET /v1/grants", "").1;
    let axes = json!([{"axis": "x", "max_velocity": 20.0, "moves": false}]);
    assert_eq!(grants, json!({"parameters": false, "axes": axes}));
    let to = r#"{"to":1,"velocity":1}"#;
    assert_eq!(ask(&attached, "POST /v1/axes/x/move", to).0, 403);
    assert_eq!(ask(&attached, "POST /v1/axes/y/enable", "").0, 403);
    // By its recovery `y` would begin again.
    let (status, answer) = ask(&attached, "POST /v1/axes/x/recover", "");
    assert_eq!((status, code(&answer)), (403, "not_granted"));
    assert!(answer.to_string().contains("`y`"), "{answer}");
    // All axes are those that are granted.
    assert_eq!(ask(&attached, "POST /v1/enable", "").0, 200);
    let states: Vec<_> = net.axes().map(|axis| axis.status().state).collect();
    assert_eq!(states, [State::OperationEnabled, State::SwitchOnDisabled]);
    assert_eq!(ask(&attached, "POST /v1/axes/x/enable", "").0, 200);
    let mut socket = websocket(&attached, "/v1/control");
    for (axis, velocity, refused) in [
        ("y", 1.0, "not_granted"),
        ("x", 20.1, "too_fast"),
        ("x", -21.0, "too_fast"),
    ] {
        let now = tick(&mut socket);
        hold(&mut socket, axis, velocity, now);
        assert_eq!(
            code(&answered(&mut socket)),
            refused,
            "{axis} with {velocity}"
        );
    }
    drop((socket, attached));

    let unknown = Grant::Motion {
        axes: vec!["z".into()],
    };
    let still = Grant::Jog {
        axes: vec!["x".into()],
        max_velocity: 0.0,
    };
    for wrong in [unknown, still] {
        let runtime = tempfile::tempdir().unwrap();
        let attach = Attach::new("sim0").directory(runtime.path().join("servocrab"));
        assert!(matches!(
            serve(&net, attach.grant(wrong)),
            Err(AttachError::Grant(_))
        ));
    }
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn an_axis_is_moved_to_a_position_in_its_unit_and_the_outcome_is_the_answer() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[motion()]);
    assert_eq!(ask(&attached, "POST /v1/axes/x/enable", "").0, 200);
    let (status, answer) = ask(
        &attached,
        "POST /v1/axes/x/move",
        r#"{"to":1.5,"velocity":50}"#,
    );
    assert_eq!(status, 200, "{answer}");
    let x = net.axis_in::<Mm>("x").unwrap();
    assert!((x.status().position - 1.5).abs() < 0.1, "{:?}", x.status());
    let (_, answer) = ask(
        &attached,
        "POST /v1/axes/x/move",
        r#"{"by":-1,"velocity":50}"#,
    );
    assert_eq!(answer["done"], true, "{answer}");
    assert!((x.status().position - 0.5).abs() < 0.1, "{:?}", x.status());
    for (body, expected) in [
        (r#"{"velocity":5}"#, "bad_body"),
        (r#"{"to":1,"by":1,"velocity":5}"#, "bad_body"),
        (r#"{"to":1e300,"velocity":5}"#, "position"),
        (r#"{"to":1,"velocity":-5}"#, "velocity"),
        ("{", "bad_body"),
    ] {
        let (status, answer) = ask(&attached, "POST /v1/axes/x/move", body);
        assert_eq!((status, code(&answer)), (422, expected), "{body}");
    }
    let counted = ask(&attached, "GET /v1/statistics", "").1;
    assert_eq!(counted["axes"][0]["motions"], json!({"reached": 2}));
    // The program has the mode: it is asked, and once it agrees the client may move.
    let held = smol::block_on(x.profile_position()).unwrap();
    let (status, answer) = ask(
        &attached,
        "POST /v1/axes/x/move",
        r#"{"to":1,"velocity":50}"#,
    );
    assert_eq!((status, code(&answer)), (409, "in_use"));
    let AskedFor { axis, client } = smol::block_on(attached.asked()).unwrap();
    let own = format!("process {}", std::process::id());
    assert!(axis == "x" && client.contains(&own), "{axis} for {client}");
    smol::block_on(held.release()).unwrap();
    assert_eq!(
        ask(
            &attached,
            "POST /v1/axes/x/move",
            r#"{"to":1,"velocity":50}"#
        )
        .0,
        200
    );
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_move_has_the_ramps_that_are_asked_for() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[motion()]);
    enabled(&net);
    let by = r#"{"by":1,"velocity":50,"acceleration":400,"deceleration":300}"#;
    let (status, answer) = ask(&attached, "POST /v1/axes/x/move", by);
    assert_eq!(status, 200, "{answer}");
    let sdo = net.sdo(0).unwrap();
    let held = smol::block_on(async {
        let acceleration = sdo.read(obj::PROFILE_ACCELERATION).await;
        (acceleration, sdo.read(obj::PROFILE_DECELERATION).await)
    });
    assert_eq!(held, (Ok(400_000), Ok(300_000)));
    let wrong = r#"{"by":1,"velocity":50,"acceleration":-400}"#;
    let (status, answer) = ask(&attached, "POST /v1/axes/x/move", wrong);
    assert_eq!((status, code(&answer)), (422, "acceleration"));
    smol::block_on(net.shutdown()).unwrap();
}

/// Waits until what is shown of `x` is so.
fn until_x(attached: &Attached, is_so: impl Fn(&Value) -> bool) -> Value {
    let started = Instant::now();
    loop {
        let x = ask(attached, "GET /v1/axes", "").1[0].take();
        if is_so(&x) {
            return x;
        }
        assert!(started.elapsed() < TIME, "{x}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_drive_that_has_left_op_is_named_and_brought_back_where_all_its_axes_are_granted() {
    let (net, segment) = machine();
    let both = Grant::Motion {
        axes: vec!["x".into(), "y".into()],
    };
    let (_runtime, attached) = shown(&net, &[both]);
    assert_eq!(
        ask(&attached, "GET /v1/axes", "").1[0]["trouble"],
        Value::Null
    );
    let fall = |segment: &Mutex<Segment>| {
        let mut segment = segment.lock().unwrap();
        segment.device_mut(0).unwrap().fall_to_safe_op(0x001B);
    };
    fall(&segment);
    let x = until_x(&attached, |x| x["trouble"]["kind"] == "lost");
    let text = x["trouble"]["text"].as_str().unwrap();
    assert!(text.contains("SAFEOP"), "{text}");
    let devices = ask(&attached, "GET /v1/devices", "").1;
    assert_eq!(devices[0]["state"], "SAFEOP");
    assert_eq!(devices[0]["error"], 0x001B);
    let (status, answer) = ask(&attached, "POST /v1/axes/x/recover", "");
    assert_eq!((status, &answer["done"]), (200, &true.into()), "{answer}");
    until_x(&attached, |x| x["trouble"]["kind"] != "lost");
    assert_eq!(ask(&attached, "GET /v1/devices", "").1[0]["state"], "OP");
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn what_was_commanded_is_listed_with_who_and_how_it_ended() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[jog(), motion(), Grant::Parameters]);
    assert_eq!(ask(&attached, "GET /v1/commands", "").1, json!([]));
    // The end of the program's last handle would stop the axis.
    let _kept = net.axis("x").unwrap();
    for (request, body) in [
        ("POST /v1/axes/x/enable", ""),
        ("POST /v1/axes/x/move", r#"{"by":1,"velocity":50}"#),
        ("POST /v1/od/0/6066h/0", r#"{"bytes":[232,3]}"#),
        ("POST /v1/od/0/2FFFh/0", r#"{"bytes":[1]}"#),
        ("POST /v1/axes/x/stop", ""),
        ("POST /v1/axes/x/stop", ""),
        // What is not granted was not commanded.
        ("POST /v1/axes/y/enable", ""),
    ] {
        ask(&attached, request, body);
    }
    let mut socket = websocket(&attached, "/v1/control");
    assert_eq!(ask(&attached, "POST /v1/axes/x/enable", "").0, 200);
    begun(&net, &mut socket, 10.0);
    let release = json!({"release": {"axis": "x"}}).to_string();
    socket.send(Message::text(release)).unwrap();
    let end = answered(&mut socket);
    assert_eq!(end["jog"]["state"], "released", "{end}");
    let all = ask(&attached, "GET /v1/commands", "").1;
    let shown: Vec<_> = (all.as_array().unwrap().iter())
        .map(|command| (command["what"].as_str().unwrap(), command["done"] == true))
        .collect();
    assert_eq!(
        shown,
        [
            ("enable x", true),
            ("move x by 1 mm with 50 mm/s", true),
            ("write 6066h:00 of drive 0 to [E8, 03]", true),
            ("write 2FFFh:00 of drive 0 to [01]", false),
            ("stop x", true),
            ("enable x", true),
            ("jog x with 10 mm/s", true),
        ]
    );
    assert_eq!(all[4]["times"], 2);
    let own = format!("process {}", std::process::id());
    let client = all[1]["client"].as_str().unwrap();
    assert!(client.contains(&own), "{client}");
    assert!(all[1]["at"].as_f64().unwrap() > 1.6e9);
    assert!(all[1]["outcome"].as_str().unwrap().starts_with("reached"));
    smol::block_on(net.shutdown()).unwrap();
}

/// The AX2000 ends each set-point before the next one.
#[test]
fn an_axis_whose_drive_can_replace_no_move_is_moved_from_standstill() {
    let mut segment = Segment::new().with(personality::ax2000());
    let wire = Wire::new(move |frame, now| segment.process(frame, now));
    let builder = Network::builder()
        .link(wire)
        .watchdog(Duration::from_secs(5))
        .drive(0, DriveConfig::new(drives::ax2000()).axis("x"));
    let net = smol::block_on(builder.start()).unwrap();
    let (_runtime, attached) = shown(&net, &[motion()]);
    enabled(&net);
    let by = json!({"by": 500, "velocity": 5000}).to_string();
    for _ in 0..2 {
        let (status, answer) = ask(&attached, "POST /v1/axes/x/move", &by);
        assert_eq!((status, &answer["done"]), (200, &true.into()), "{answer}");
    }
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn objects_are_written_but_for_those_of_the_process_data_and_of_the_library() {
    let (net, segment) = machine();
    let (_runtime, attached) = shown(&net, &[Grant::Parameters]);
    let listed = ask(&attached, "GET /v1/od/0", "").1;
    let listed = listed.as_array().unwrap().clone();
    let names = listed
        .iter()
        .any(|object| object["index"] == 0x6041 && object["access"].is_string());
    assert!(names, "{} objects", listed.len());
    let (status, answer) = ask(&attached, "POST /v1/od/0/6066h/0", r#"{"bytes":[232,3]}"#);
    assert_eq!(status, 200, "{answer}");
    let read = ask(&attached, "GET /v1/od/0/6066h/0", "").1;
    assert_eq!(read["bytes"], json!([232, 3]));
    for object in [
        "6040h/0", "60FFh/0", "6860h/0", "605Ah/0", "1C12h/1", "1600h/0", "6081h/0",
    ] {
        let request = format!("POST /v1/od/0/{object}");
        let (status, answer) = ask(&attached, &request, r#"{"bytes":[0,0]}"#);
        assert_eq!((status, code(&answer)), (403, "owned"), "{object}");
    }
    for (request, body, expected) in [
        ("POST /v1/od/0/6066h/0", "{}", "bad_body"),
        ("POST /v1/od/0/6066h/0", r#"{"bytes":[]}"#, "bad_body"),
        ("POST /v1/od/7/6066h/0", r#"{"bytes":[1]}"#, "no_drive"),
        ("POST /v1/od/0/six/0", r#"{"bytes":[1]}"#, "no_object"),
        ("POST /v1/od/0/2FFFh/0", r#"{"bytes":[1]}"#, "aborted"),
    ] {
        let (_, answer) = ask(&attached, request, body);
        assert_eq!(code(&answer), expected, "{request} {body}");
    }
    drop(segment);
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn an_object_that_is_in_the_process_data_in_part_is_not_written_as_a_whole() {
    let (net, _segment) = machine_of(|axis| axis.map_output(obj::DIGITAL_OUTPUTS));
    let (_runtime, attached) = shown(&net, &[Grant::Parameters]);
    // Its number of entries, the mapped one and the mask.
    let whole = r#"{"bytes":[2,0,1,0,0,0,1,0,0,0]}"#;
    for object in [
        "60FEh/1",
        "60FEh/0?complete=true",
        "60FEh/1?complete=true",
        "68FEh/0?complete=true",
    ] {
        let request = format!("POST /v1/od/0/{object}");
        let (status, answer) = ask(&attached, &request, whole);
        assert_eq!((status, code(&answer)), (403, "owned"), "{object}");
    }
    // The mask alone is not in the process data, and the objects of others are written as a whole.
    let (status, answer) = ask(&attached, "POST /v1/od/0/60FEh/2", r#"{"bytes":[1,0,0,0]}"#);
    assert_eq!(status, 200, "{answer}");
    let (_, answer) = ask(
        &attached,
        "POST /v1/od/0/6066h/0?complete=true",
        r#"{"bytes":[0,0]}"#,
    );
    assert_ne!(answer["error"]["code"], "owned", "{answer}");
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn the_objects_of_a_running_programs_drives_are_used_as_those_of_a_line() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[Grant::Parameters]);
    let used = async {
        let drives = Program::open(attached.socket())?.drives().await?;
        let [sdo] = drives.as_slice() else {
            panic!("{drives:?}");
        };
        assert_eq!(sdo.drive(), net.drives().next().unwrap());
        sdo.write(obj::FOLLOWING_ERROR_TIME_OUT, 1000).await?;
        assert_eq!(sdo.read(obj::FOLLOWING_ERROR_TIME_OUT).await?, 1000);
        // A wish of more time goes with it.
        let patient = sdo.clone().with_timeout(Duration::from_secs(9));
        assert_eq!(patient.read_bytes(0x6066, 0).await?, [232, 3]);
        let own = net.sdo(0).unwrap();
        assert_eq!(
            sdo.read_complete(0x1018, 0)
                .await
                .map_err(|error| error.error),
            own.read_complete(0x1018, 0)
                .await
                .map_err(|error| error.error)
        );

        // What the drive says against it is the drive's word, and what the program says the program's.
        let refused = sdo.read_bytes(0x2FFF, 0).await.unwrap_err();
        assert_eq!(refused.error.abort_code(), Some(AbortCode::NO_OBJECT));
        let (asked, known) = (sdo.dictionary().await, own.dictionary().await);
        assert_eq!(
            asked.map_err(|error| error.error),
            known.map_err(|error| error.error)
        );
        let owned = sdo.write(obj::TARGET_POSITION, 1).await.unwrap_err();
        let text = owned.to_string();
        assert!(matches!(owned.error, SdoError::Remote { .. }), "{text}");
        assert!(text.contains("in the process data"), "{text}");
        Ok::<_, Box<dyn std::error::Error>>(drives)
    };
    let drives = smol::block_on(used).unwrap();
    drop(attached);
    let gone = smol::block_on(drives[0].read(obj::FOLLOWING_ERROR_TIME_OUT)).unwrap_err();
    assert!(
        gone.to_string().contains("nobody shows a network"),
        "{gone}"
    );
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_client_of_the_stream_that_announces_too_long_a_message_is_let_go() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[]);
    let mut socket = websocket(&attached, "/v1/stream?signals=x.position");
    said(&mut socket);
    // The head of a masked text of ten million bytes (RFC 6455, section 5.2), which never comes.
    let head = [0x81, 0xFF, 0, 0, 0, 0, 0, 0x98, 0x96, 0x80, 1, 2, 3, 4];
    socket.get_mut().write_all(&head).unwrap();
    // Some seconds of the stream.
    let closed = (0..100).any(|_| !matches!(socket.read(), Ok(Message::Binary(_))));
    assert!(closed, "it goes on");
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_stream_has_every_cycle_once_and_two_clients_share_it() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[]);
    let path = "/v1/stream?signals=x.position,x.state,lateness";
    let mut sockets = [websocket(&attached, path), websocket(&attached, path)];
    for socket in &mut sockets {
        let heading = said(socket);
        assert_eq!(
            heading["signals"][0],
            json!({"signal": "x.position", "unit": "mm"})
        );
        assert_eq!(heading["signals"].as_array().unwrap().len(), 3);
        let (mut last, mut cycles) = (None, 0);
        while cycles < 200 {
            let Message::Binary(block) = socket.read().unwrap() else {
                continue;
            };
            let word = |at: usize| u64::from_le_bytes(block[at..at + 8].try_into().unwrap());
            let (count, signals) = (word(8) & 0xFFFF_FFFF, word(8) >> 32);
            assert_eq!((word(0), signals), (0, 3), "nothing is lost");
            assert_eq!(block.len() as u64, 16 + count * (16 + 8 * 3));
            for cycle in 0..count as usize {
                let at = 16 + cycle * 40;
                let number = word(at);
                assert!(
                    last.is_none_or(|last| number == last + 1),
                    "{number} after {last:?}"
                );
                last = Some(number);
                let value = |signal: usize| f64::from_bits(word(at + 16 + 8 * signal));
                assert!(value(0).abs() < 1.0 && value(1) == 1.0 && value(2) >= 0.0);
            }
            cycles += count;
        }
    }
    for (query, status) in [
        ("signals=z.position", 400),
        ("signals=", 400),
        ("signals=x.position&every=0", 400),
        ("signals=x.nothing", 400),
    ] {
        let stream = UnixStream::connect(attached.socket()).unwrap();
        let request = format!("ws://localhost/v1/stream?{query}")
            .into_client_request()
            .unwrap();
        let refused = client_with_config(request, stream, None);
        let Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) = refused
        else {
            panic!("{query} was not refused");
        };
        assert_eq!(response.status(), status, "{query}");
    }
    smol::block_on(net.shutdown()).unwrap();
    // The streams end with the network.
    for socket in &mut sockets {
        while !matches!(socket.read(), Ok(Message::Close(_)) | Err(_)) {}
    }
}

/// The names of axes and of terminals may have any characters, and "16 outputs, 16 inputs" is one of them.
#[test]
fn a_signal_whose_name_has_a_comma_is_streamed() {
    let mut segment = Segment::new().with(personality::akd2g());
    let wire = Wire::new(move |frame: &mut [u8], now| segment.process(frame, now));
    let drive = DriveConfig::new(drives::akd2g())
        .axis("gantry, left")
        .axis("y");
    let builder = Network::builder()
        .link(wire)
        .cycle(Duration::from_millis(2))
        .watchdog(Duration::from_secs(5))
        .drive(0, drive);
    let net = smol::block_on(builder.start()).unwrap();
    let (_runtime, attached) = shown(&net, &[]);
    let left: Signal = "gantry, left.position".parse().unwrap();
    let right: Signal = "y.position".parse().unwrap();
    for signals in [vec![left.clone()], vec![left, right]] {
        let watch = Watch::open(attached.socket(), &signals, 1).unwrap();
        let named: Vec<Signal> = watch
            .signals()
            .iter()
            .map(|known| known.signal.parse().unwrap())
            .collect();
        assert_eq!(named, signals);
    }
    // With each comma escaped, as clients do that escape the value as a whole.
    let mut socket = websocket(&attached, "/v1/stream?signals=y.position%2Clateness");
    assert_eq!(said(&mut socket)["signals"][1]["signal"], "lateness");
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn the_panel_of_a_program_that_has_ended_stops_the_axes_of_the_next_one_and_does_nothing_else() {
    let runtime = tempfile::tempdir().unwrap();
    let shown = |net: &Network| {
        let attach = Attach::new("sim0").directory(runtime.path().join("servocrab"));
        serve(net, attach.grant(motion())).unwrap()
    };
    let (first, _segment) = machine();
    let attached = shown(&first);
    let forwarded = forward(attached.socket(), 0).unwrap();
    let (address, token) = address(forwarded.panel());
    let asked = |request: &str, body: &str| {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(TIME)).unwrap();
        let length = body.len();
        let request = format!(
            "{request} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\
             Content-Length: {length}\r\n\r\n{body}"
        );
        let (status, body) = exchange(stream, &request);
        let answer: Value = serde_json::from_str(&body).unwrap();
        (status, answer)
    };
    assert_eq!(asked("GET /v1/axes", "").1[0]["unit"], "mm");
    assert_eq!(asked("GET /v1/axes", "").0, 200, "and again");
    drop(attached);
    smol::block_on(first.shutdown()).unwrap();

    // Its `x` could be in metres.
    let (second, _segment) = machine();
    let attached = shown(&second);
    let x = enabled(&second);
    let before = x.status().position;
    let by = json!({"by": 1.0, "velocity": 10.0}).to_string();
    for (request, body) in [("POST /v1/axes/x/move", &*by), ("GET /v1/axes", "")] {
        let (status, answer) = asked(request, body);
        assert_eq!((status, code(&answer)), (409, "another_start"), "{request}");
    }
    assert!((x.status().position - before).abs() < 500, "it has moved");
    assert_eq!(asked("POST /v1/axes/x/stop", "").0, 202);
    assert_eq!(asked("POST /v1/quick_stop", "").0, 202);
    // Another panel is of this one.
    let again = forward(attached.socket(), 0).unwrap();
    assert_ne!(again.panel(), forwarded.panel());
    smol::block_on(second.shutdown()).unwrap();
}

#[test]
fn over_tcp_the_page_is_for_everybody_and_the_machine_for_who_has_the_token() {
    let (net, _segment) = machine();
    let (_runtime, attached) = shown(&net, &[jog()]);
    let own = address(attached.panel().unwrap());
    let forwarded = forward(attached.socket(), 0).unwrap();
    let through = address(forwarded.panel());
    for (address, token) in [&own, &through] {
        let get = |path: &str, headers: &str| {
            let stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(TIME)).unwrap();
            let request = format!(
                "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}\r\n"
            );
            exchange(stream, &request)
        };
        let (status, page) = get("/", "");
        assert!(
            status == 200 && page.contains("no safety function"),
            "{status}"
        );
        assert_eq!(get("/panel.js", "").0, 200);
        let with = format!("Authorization: Bearer {token}\r\n");
        let (status, axes) = get("/v1/axes", &with);
        assert!(status == 200 && axes.contains("\"mm\""), "{status}: {axes}");
        assert_eq!(get("/v1/axes", "").0, 401);
        assert_eq!(
            get("/v1/axes", &format!("{with}Origin: http://example.org\r\n")).0,
            403
        );
        let port = address.port();
        assert_eq!(
            get(
                "/v1/axes",
                &format!("{with}Origin: http://localhost:{port}\r\n")
            )
            .0,
            200
        );

        // A browser gives the token among the protocols of its WebSocket.
        let websocket = |token: &str| {
            let stream = TcpStream::connect(address).unwrap();
            stream.set_read_timeout(Some(TIME)).unwrap();
            let mut request: Request = format!("ws://{address}/v1/control")
                .into_client_request()
                .unwrap();
            let offered = format!("servocrab, token.{token}").parse().unwrap();
            request
                .headers_mut()
                .insert("Sec-WebSocket-Protocol", offered);
            client_with_config(request, stream, None).ok()
        };
        let (mut socket, response) = websocket(token).unwrap();
        assert_eq!(response.headers()["sec-websocket-protocol"], "servocrab");
        assert!(said(&mut socket).get("tick").is_some());
        assert!(websocket(&"0".repeat(32)).is_none());
    }
    // The token of one is not that of the other.
    assert_ne!(own.1, through.1);
    smol::block_on(net.shutdown()).unwrap();
}
