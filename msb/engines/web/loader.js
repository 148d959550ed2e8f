"use strict";
// The page contains the published modules of three.js, compressed.
// This script makes a blob of each module, and replaces imports in later modules with the address of the blob.
// After the modules, the script runs the scripts of the page.
// The promise `ready` resolves to false if the page cannot show anything.
const byId = (id) => document.getElementById(id);
const say = (text) => { byId("message").textContent = text; byId("message").hidden = !text; };

async function decompress(element) {
  const bytes = Uint8Array.from(atob(element.textContent.trim()), (c) => c.charCodeAt(0));
  element.remove();
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

async function importModules() {
  const addresses = {}, exports = {};
  for (const element of [...document.querySelectorAll("script[data-module]")]) {
    const text = (await decompress(element)).replace(/from '[./\w]*?([\w.]+)'/g, (all, name) => {
      const address = addresses[name === "three" ? "three.module.js" : name];
      return address ? `from '${address}'` : all;
    });
    const name = element.dataset.module;
    addresses[name] = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
    Object.assign(exports, await import(addresses[name]));
  }
  return exports;
}

const ready = (async () => {
  try {
    globalThis.THREE = await importModules();
    const script = document.createElement("script");
    script.textContent = byId("script").textContent;
    document.body.append(script);
  } catch (error) {
    say(`This browser cannot show the page: ${error.message || error}. Try a current Chrome, Edge, Firefox or Safari.`);
    return false;
  }
  return typeof main === "function" && main();  // if `main` is missing, a script has failed and shown a message
})();
