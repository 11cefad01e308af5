//! Chromium by its driver: the WebDriver protocol, as far as it is needed here.

use std::{
    collections::HashMap,
    fs,
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use ureq::Agent;

use super::{
    Result, TIME,
    network::{Cable, FAR},
    until,
};

const PORT: u16 = 9515;
/// By this name the protocol tells an element from a text.
const ELEMENT: &str = "element-6066-11e4-a52e-4f735466cecf";

/// One browser, which ends with this.
pub(crate) struct Browser {
    driver: Child,
    agent: Agent,
    session: String,
    profile: tempfile::TempDir,
}

impl Browser {
    pub(crate) fn start(cable: &Cable) -> Result<Self> {
        let profile = tempfile::tempdir()?;
        let driver = cable
            .inside("chromedriver")
            .args([
                &format!("--port={PORT}"),
                "--allowed-ips=",
                "--allowed-origins=*",
            ])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|error| format!("chromedriver (Debian: chromium-driver): {error}"))?;
        let agent: Agent = Agent::config_builder()
            .timeout_global(Some(TIME))
            .http_status_as_error(false)
            .build()
            .into();
        let mut browser = Self {
            driver,
            agent,
            session: String::new(),
            profile,
        };
        until("chromedriver answers", || {
            Ok(TcpStream::connect((FAR, PORT)).is_ok())
        })?;
        let profile = browser.profile.path().display();
        let options = json!({"args": [
            "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1300,1700",
            "--hide-scrollbars", format!("--user-data-dir={profile}"),
        ]});
        let wanted = json!({"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": options}}});
        let begun = browser.post("/session", &wanted)?;
        let session = begun["sessionId"].as_str().ok_or("no session")?;
        browser.session = format!("/session/{session}");
        Ok(browser)
    }

    fn post(&self, path: &str, body: &Value) -> Result<Value> {
        let url = format!("http://{FAR}:{PORT}{}{path}", self.session);
        let mut response = self
            .agent
            .post(url)
            .header("Content-Type", "application/json")
            .send(body.to_string())
            .map_err(|error| format!("{path} {body}: {error}"))?;
        answer(path, &response.body_mut().read_to_string()?)
    }

    fn get(&self, path: &str) -> Result<Value> {
        let url = format!("http://{FAR}:{PORT}{}{path}", self.session);
        let mut response = self.agent.get(url).call()?;
        let body = response
            .body_mut()
            .with_config()
            .limit(64 * 1024 * 1024)
            .read_to_string()?;
        answer(path, &body)
    }

    pub(crate) fn open(&self, url: &str) -> Result<()> {
        self.post("/url", &json!({"url": url})).map(drop)
    }

    /// What this script returns.
    pub(crate) fn run(&self, script: &str) -> Result<Value> {
        self.post("/execute/sync", &json!({"script": script, "args": []}))
    }

    /// What this script gives to its last argument.
    pub(crate) fn run_async(&self, script: &str, arguments: &Value) -> Result<Value> {
        self.post(
            "/execute/async",
            &json!({"script": script, "args": arguments}),
        )
    }

    /// What a script returns that uses these names of a file of the page.
    pub(crate) fn with(&self, file: &str, names: &str, script: &str) -> Result<Value> {
        self.run(&format!(
            "return import(`${{location.origin}}/{file}`).then(async ({{ {names} }}) => {{ {script} }})"
        ))
    }

    pub(crate) fn wait_with(
        &self,
        what: &str,
        file: &str,
        names: &str,
        script: &str,
    ) -> Result<()> {
        until(what, || Ok(self.with(file, names, script)? == true))
    }

    pub(crate) fn wait(&self, what: &str, script: &str) -> Result<()> {
        until(what, || Ok(self.run(script)? == true))
    }

    fn element(&self, css: &str) -> Result<String> {
        let found = self.post("/element", &json!({"using": "css selector", "value": css}))?;
        let id = found[ELEMENT].as_str();
        Ok(id
            .ok_or_else(|| format!("no {css} on the page"))?
            .to_owned())
    }

    /// Presses the button with the mouse, and holds it.
    pub(crate) fn hold(&self, css: &str) -> Result<()> {
        let element = json!({ELEMENT: self.element(css)?});
        self.run("scrollTo(0, 0)")?;
        self.pointer(&json!([
            {"type": "pointerMove", "duration": 0, "origin": element, "x": 0, "y": 0},
            {"type": "pointerDown", "button": 0},
        ]))
    }

    pub(crate) fn release(&self) -> Result<()> {
        self.pointer(&json!([{"type": "pointerUp", "button": 0}]))
    }

    fn pointer(&self, actions: &Value) -> Result<()> {
        let mouse = json!({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions});
        self.post("/actions", &json!({"actions": [mouse]}))
            .map(drop)
    }

    /// A click in the middle of an element, which is brought into view: away from the head of the page.
    pub(crate) fn click(&self, css: &str) -> Result<()> {
        self.bring_into_view(css)?;
        let element = self.element(css)?;
        self.post(&format!("/element/{element}/click"), &json!({}))
            .map_err(|error| format!("{css}: {error}").into())
            .map(drop)
    }

    fn bring_into_view(&self, css: &str) -> Result<()> {
        let css = json!(css);
        self.run(&format!(
            "document.querySelector({css})?.scrollIntoView({{ block: 'center' }})"
        ))
        .map(drop)
    }

    /// Types into a field, in place of what it has.
    pub(crate) fn fill(&self, css: &str, text: &str) -> Result<()> {
        let element = self.element(css)?;
        self.post(&format!("/element/{element}/clear"), &json!({}))?;
        self.type_into(css, text)
    }

    pub(crate) fn type_into(&self, css: &str, text: &str) -> Result<()> {
        let element = self.element(css)?;
        let path = format!("/element/{element}/value");
        self.post(&path, &json!({"text": text})).map(drop)
    }

    /// Drags an element by so many pixels.
    pub(crate) fn drag(&self, css: &str, x: i32, y: i32) -> Result<()> {
        let element = json!({ELEMENT: self.element(css)?});
        self.bring_into_view(css)?;
        self.pointer(&json!([
            {"type": "pointerMove", "duration": 0, "origin": element, "x": 0, "y": 0},
            {"type": "pointerDown", "button": 0},
            {"type": "pointerMove", "duration": 50, "origin": "pointer", "x": x, "y": y},
            {"type": "pointerUp", "button": 0},
        ]))
    }

    /// The size of the page in pixels; of a phone it has fingers too.
    pub(crate) fn resize(&self, width: u32, height: u32, is_phone: bool) -> Result<()> {
        let metrics = json!({
            "width": width,
            "height": height,
            "deviceScaleFactor": if is_phone { 2 } else { 1 },
            "mobile": is_phone,
        });
        self.of_chrome("Emulation.setDeviceMetricsOverride", &metrics)
    }

    /// What the computer has chosen: `light` or `dark`.
    pub(crate) fn theme(&self, theme: &str) -> Result<()> {
        let features = json!([{"name": "prefers-color-scheme", "value": theme}]);
        self.of_chrome("Emulation.setEmulatedMedia", &json!({"features": features}))
    }

    fn of_chrome(&self, command: &str, parameters: &Value) -> Result<()> {
        let asked = json!({"cmd": command, "params": parameters});
        self.post("/goog/cdp/execute", &asked).map(drop)
    }

    pub(crate) fn key(&self, key: &str) -> Result<()> {
        let actions = json!([{"type": "keyDown", "value": key}, {"type": "keyUp", "value": key}]);
        let keys = json!({"type": "key", "id": "keys", "actions": actions});
        self.post("/actions", &json!({"actions": [keys]})).map(drop)
    }

    /// Another tab comes before this one.
    pub(crate) fn hide(&self) -> Result<()> {
        let opened = self.post("/window/new", &json!({"type": "tab"}))?;
        self.post("/window", &json!({"handle": opened["handle"]}))
            .map(drop)
    }

    pub(crate) fn picture(&self, file: &Path) -> Result<()> {
        save(&self.get("/screenshot")?, file)
    }

    pub(crate) fn picture_of(&self, css: &str, file: &Path) -> Result<()> {
        let element = self.element(css)?;
        save(&self.get(&format!("/element/{element}/screenshot"))?, file)
    }

    /// A signal to every process of the browser; its driver gets none.
    pub(crate) fn signal(&self, name: &str) -> Result<()> {
        let mut processes: Vec<String> = descendants(self.driver.id())?
            .into_iter()
            .filter(|id| {
                let command = fs::read_to_string(format!("/proc/{id}/cmdline")).unwrap_or_default();
                command.contains("chromium") && !command.contains("chromedriver")
            })
            .map(|id| id.to_string())
            .collect();
        if processes.is_empty() {
            return Err("no process of the browser was found".into());
        }
        processes.insert(0, format!("-{name}"));
        // Some may have ended meanwhile.
        Command::new("kill")
            .args(processes)
            .stderr(Stdio::null())
            .status()?;
        Ok(())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        // Each by its own id; what is stopped ends as well.
        let processes = descendants(self.driver.id()).unwrap_or_default();
        let ids = processes.iter().map(ToString::to_string);
        let _ = Command::new("kill")
            .arg("-KILL")
            .args(ids)
            .stderr(Stdio::null())
            .status();
        let _ = self.driver.kill();
        let _ = self.driver.wait();
        // The port is free once the driver is gone.
        let started = Instant::now();
        while TcpStream::connect((FAR, PORT)).is_ok() && started.elapsed() < TIME {
            sleep(Duration::from_millis(10));
        }
    }
}

fn answer(path: &str, body: &str) -> Result<Value> {
    let mut body: Value = serde_json::from_str(body)?;
    let value = body["value"].take();
    match value["error"].as_str() {
        Some(error) => Err(format!("{path}: {error}: {}", value["message"]).into()),
        None => Ok(value),
    }
}

fn save(picture: &Value, file: &Path) -> Result<()> {
    let picture = STANDARD.decode(picture.as_str().ok_or("no picture")?)?;
    Ok(fs::write(file, picture)?)
}

/// All processes that this one has begun, and those that they have.
fn descendants(of: u32) -> Result<Vec<u32>> {
    let mut children: HashMap<u32, Vec<u32>> = HashMap::new();
    for entry in fs::read_dir("/proc")? {
        let name = entry?.file_name();
        let Some(id) = name.to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        // The name may have anything in it; the state and the parent come behind its bracket.
        let parent = stat
            .rsplit_once(") ")
            .and_then(|(_, rest)| rest.split(' ').nth(1)?.parse().ok());
        if let Some(parent) = parent {
            children.entry(parent).or_default().push(id);
        }
    }
    let mut found = children.remove(&of).unwrap_or_default();
    let mut place = 0;
    while let Some(id) = found.get(place) {
        found.extend(children.remove(id).unwrap_or_default());
        place += 1;
    }
    Ok(found)
}
