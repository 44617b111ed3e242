// What the buttons at the top do: undo and redo, the link, the study, the figures and the data.
import { notice, say } from "./notice.js";
import { dataCsv, download, figuresSvg, fileName, pngOf } from "./save.js";

const actionPart = (id) => document.getElementById(id);

export class Actions {
  constructor(page) {
    this.page = page;
    const { store } = page;
    actionPart("undo").addEventListener("click", () => this.travel(-1));
    actionPart("redo").addEventListener("click", () => this.travel(1));
    document.addEventListener("keydown", (event) => {
      if (!(event.ctrlKey || event.metaKey) || event.target.matches('input[type="text"]')) return;
      const key = event.key.toLowerCase();
      if (key !== "z" && key !== "y") return;
      event.preventDefault();
      this.travel(key === "y" || event.shiftKey ? 1 : -1);
    });
    actionPart("zoom-in").addEventListener("click", () => page.modes.zoomBy(2));
    actionPart("zoom-out").addEventListener("click", () => page.modes.zoomBy(0.5));
    actionPart("link").addEventListener("click", () => this.copyLink());
    actionPart("save").addEventListener("click", () => this.saveStudy());
    const menu = actionPart("downloads");
    menu.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      menu.open = false;
      menu.querySelector("summary").focus();
    });
    document.addEventListener("click", (event) => {
      if (!menu.contains(event.target)) menu.open = false;
    });
    const name = (ending) => fileName(page.info.study.name, ending);
    actionPart("svg").addEventListener("click", () =>
      this.take(() => download(name("svg"), this.svg(), "image/svg+xml")),
    );
    actionPart("png").addEventListener("click", () =>
      this.take(async () => download(name("png"), await pngOf(this.svg()), "image/png")),
    );
    actionPart("csv").addEventListener("click", () =>
      this.take(() => download(name("csv"), dataCsv(page.answers, store.state), "text/csv")),
    );
  }

  async take(make) {
    actionPart("downloads").open = false;
    try {
      await make();
    } catch (error) {
      notice(error.message, true);
    }
  }

  travel(by) {
    const { store, fields } = this.page;
    fields.clearFaults();
    notice("");
    if (store.step(by)) say(by < 0 ? "Undone." : "Done again.");
    fields.update();
  }

  async copyLink() {
    this.page.store.writeLink();
    const link = window.location.href;
    try {
      await navigator.clipboard.writeText(link);
      notice(
        "The link is copied. While this explorer runs it opens this state; its part after # opens it in another run with --state.",
      );
    } catch {
      notice("The browser does not let the page copy. The address above is the link.");
    }
  }

  async saveStudy() {
    const { page } = this;
    try {
      const reply = await page.ask("save", page.transport.seq + 1, page.store.state);
      if (reply.status === 422) return page.refused(reply.faults);
      download(reply.answer.name, reply.answer.toml, "application/toml");
      const { name, words } = reply.answer;
      notice(`${name} is saved.${words ? ` ${words}` : ""} Run it with: vsgdesign run ${name}`);
    } catch (error) {
      page.lost();
    }
    return undefined;
  }

  svg() {
    const { map, modes, bode, response, info, store, answers } = this.page;
    const { scr, x_over_r: ratio, hold, event } = store.state;
    const held = hold ? `, gains held at SCR ${hold.scr.toFixed(2)}, X/R ${hold.x_over_r.toFixed(2)}` : "";
    const header = answers.map ? answers.map.header : {};
    const figure = `${header.label || ""}${header.controller ? ` of ${header.controller}` : ""}`;
    const kind = ((info.events || []).find((e) => e.kind === event.kind) || {}).label || event.kind;
    const titles = {
      map: figure,
      response: `Response to: ${kind} (solid EMT, dotted linear)`,
      modes: "Modes",
      bode: `Open loop ${bode.loop}`,
    };
    const headline = [info.study.title || info.study.name, `SCR ${scr.toFixed(2)}, X/R ${ratio.toFixed(2)}${held}`];
    const controllers = answers.linear ? this.page.shownOf(answers.linear) : [];
    return figuresSvg({ map, modes, bode, response, titles, headline, controllers });
  }
}
