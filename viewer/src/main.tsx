import { render } from "preact";
import "uplot/dist/uPlot.min.css";
import { Choices, Transport } from "./controls";
import { CurvesSection } from "./curves";
import { data } from "./data";
import { KEYS, listen } from "./keys";
import { Legend } from "./legend";
import { Notes, Numbers } from "./numbers";
import { ScatterSection } from "./scatter";
import { Stage, painter } from "./stage";
import { clip } from "./state";
import "./style.css";
import { TablesSection } from "./tables";

function Viewer() {
  const found = clip.value;
  if (!found) return <p class="note">There are no pictures in this report.</p>;
  if (!found.frames.length) {
    return <><Choices /><Notes /><p class="note">No frame of this clip was kept.</p></>;
  }
  return (
    <section id="viewer" aria-label="Pictures">
      <Choices />
      <Notes />
      <Stage />
      <Legend />
      <Transport />
      {painter.value === "canvas" && (
        <p class="note" id="no-webgl">
          {location.hash === "#2d" ? "Drawn without WebGL." : "This browser has no WebGL 2: pictures are drawn without it, more slowly."}
        </p>
      )}
      {data.note && <p class="note">{data.note}</p>}
      <Numbers />
      <details><summary>Keys</summary>
        <dl class="keys">{KEYS.map(([keys, what]) => <><dt>{keys}</dt><dd>{what}</dd></>)}</dl>
      </details>
    </section>
  );
}

function About() {
  return data.about.length === 0 ? null : (
    <section id="how">
      <h2>How it is computed</h2>
      {data.about.map(({ title, text, terms }) => (
        <>
          <h3>{title}</h3>
          {text && <p>{text}</p>}
          <dl>{terms.map(([term, what]) => <><dt>{term}</dt><dd>{what}</dd></>)}</dl>
        </>
      ))}
    </section>
  );
}

function App() {
  return (
    <>
      <header>
        <h1>{data.title}</h1>
        {data.summary && <p>{data.summary}</p>}
      </header>
      <main>
        <Viewer />
        <TablesSection />
        <CurvesSection />
        <ScatterSection />
        <About />
      </main>
      <footer>
        Made by nte {data.version}.{data.rows.length > 0 && data.summary && " The same numbers, frame by frame, are in metrics.json."}
      </footer>
    </>
  );
}

listen();
render(<App />, document.getElementById("app")!);
