"use strict";
// three.js is in the page as the modules that were published, packed. Each becomes a blob, and the modules that
// import it are given its address; then the page's own scripts run. `ready` is false where nothing is shown.
const byId = (id) => document.getElementById(id);
const say = (text) => { byId("message").textContent = text; byId("message").hidden = !text; };

async function unpacked(element) {
  const bytes = Uint8Array.from(atob(element.textContent.trim()), (c) => c.charCodeAt(0));
  element.remove();
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

async function imported() {
  const addresses = {}, found = {};
  for (const element of [...document.querySelectorAll("script[data-module]")]) {
    const text = (await unpacked(element)).replace(/from '[./\w]*?([\w.]+)'/g, (all, name) => {
      const address = addresses[name === "three" ? "three.module.js" : name];
      return address ? `from '${address}'` : all;
    });
    const name = element.dataset.module;
    addresses[name] = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    Object.assign(found, await import(addresses[name]));
  }
  return found;
}

const ready = (async () => {
  try {
    globalThis.THREE = await imported();
    const script = document.createElement("script");
    script.textContent = byId("script").textContent;
    document.body.append(script);
  } catch (error) {
    say(`This browser cannot show the page: ${error.message || error}`);
    return false;
  }
  return typeof main === "function" && main();  // without it a script has said what is wrong
})();
